"""The Foxglove server as a process of its own on a real bus, and a client of another library that looks on."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from adapters.robots.g1 import twist_keys
from servers.foxglove import KIND, MOST_KEYS, FoxgloveConfig
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.connection import Connection
from station.bus.contracts import contract
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.stamp import Stamp, boot_id
from station.config import build
from station.errors import BusError, ConfigError, StationError
from station.life import events
from station.life.server import Health, read_health
from tests import strider
from tests.episode.filming import cloud
from tests.servers.foxglove_client import FoxgloveClient, fields
from tests.waiting import DEADLINE_S, wait_until

pytest.importorskip("foxglove", reason="needs the extra 'foxglove'")

ROBOT = twist_keys.TWIST2_ROBOT
STATE, QPOS, GATE = keys.robot_state(ROBOT), keys.sim_qpos(ROBOT), keys.command_gate(ROBOT)
HEAD, TOP = keys.camera_image("head"), keys.lidar_cloud("top")
FAST = 0.5  # a message that is not held up comes sooner, on a machine that does other things too [s]


class Server:
    """The server's process, and what the bus says of it."""

    def __init__(self, address: BusAddress, folder: Path, **config: Any) -> None:
        self._address, self._words = address, folder / f"stderr-{len(list(folder.iterdir()))}"
        settings = json.dumps({"port": 0, **config})
        command = [
            sys.executable,
            "-m",
            "station",
            "serve",
            "foxglove",
            "--bus",
            address.url,
            "--config-json",
            settings,
        ]
        with self._words.open("wb") as stderr:
            self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=stderr, stderr=stderr)

    def health(self) -> Health | None:
        """What it last said; None while the bus is lost."""
        with contextlib.suppress(BusError), Bus(self._address, name="look", timeout_s=1.0) as bus:
            return next((said for said in read_health(bus) if said.name == "foxglove"), None)
        return None

    def detail(self) -> dict[str, Any]:
        said = self.health()
        return {} if said is None else said.detail

    def url(self) -> str:
        """Wait until it is active; return where it listens."""
        wait_until(lambda: self.process.poll() is not None or "channels" in self.detail())
        assert self.process.poll() is None, self.words()
        with Bus(self._address, name="look", timeout_s=1.0) as bus:
            return json.loads(bus.get(keys.server_config("foxglove")) or b"{}")["url"]

    def words(self) -> str:
        return self._words.read_text()

    def close(self) -> None:
        self.process.kill()
        self.process.wait()


Start = Callable[..., Server]
Join = Callable[..., FoxgloveClient]


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="test", timeout_s=5.0) as client:
        yield client


@pytest.fixture
def start(bus_server: BusAddress, tmp_path: Path) -> Iterator[Start]:
    with contextlib.ExitStack() as stack:

        def begin(**config: Any) -> Server:
            made = Server(bus_server, tmp_path, **config)
            stack.callback(made.close)
            return made

        yield begin


@pytest.fixture
def join() -> Iterator[Join]:
    with contextlib.ExitStack() as stack:

        def begin(url: str, **options: int) -> FoxgloveClient:
            made = FoxgloveClient(url, **options)
            stack.callback(made.close)
            return made

        yield begin


def stamp_of(bus: Bus, key: str) -> Stamp:
    mark = bus.read([key])[key].stamp
    assert mark is not None
    return mark


def jpeg(shade: int, side: int = 16) -> bytes:
    file = BytesIO()
    Image.new("RGB", (side, side), (shade, 0, 0)).save(file, "JPEG")
    return file.getvalue()


def test_what_is_written_comes_by_name_by_its_own_time_and_to_the_last_byte(start: Start, join: Join, bus: Bus) -> None:
    described = contract(STATE)
    assert described is not None
    values = np.random.default_rng(1).normal(size=len(described.elements))
    qpos = [0.5, -0.25, 0.79, 0.5, -0.5, 0.5, -0.5, *range(29)]
    gate, picture, points = b'{"state":"tracking", "age_s":0.25,"odd":[1,{"a":null}]}', jpeg(200), cloud(3)
    written: dict[str, bytes] = {
        STATE: codec.f64(values), QPOS: codec.f64(qpos), GATE: gate, keys.ESTOP: b"0",
        keys.operator_joints("gello"): codec.f64([1.5, -2.0]),
        twist_keys.action_body(): codec.json_vector(range(35)),
    }  # fmt: skip
    bus.publish(written)
    taken_ns = bus.clock.monotonic_ns() - 5_000_000
    bus.publish({HEAD: picture, TOP: points}, capture_ns=taken_ns)
    bus.call("SET", "stranger", b"[1, 2]")
    client = join(start().url())
    assert (client.info or client.read(1.0) or client.info)["capabilities"] == []
    command = f"{twist_keys.action_body()}/typed"
    topics = (f"{STATE}/typed", f"{QPOS}/tf", GATE, keys.ESTOP, keys.operator_joints("gello"), command, f"{HEAD}/image",
              TOP, "stranger")  # fmt: skip
    client.subscribe(*topics)
    client.until(lambda: {one.topic for one in client.messages} == set(topics))
    found = {one.topic: one for one in client.messages}
    assert len(client.messages) == len(topics), "nothing comes twice"

    assert fields(client.channels[f"{STATE}/typed"]) == list(described.names)
    assert [getattr(found[f"{STATE}/typed"].value, name) for name in described.names] == values.tolist()
    asked = contract(twist_keys.action_body())
    assert asked is not None
    assert [getattr(found[command].value, name) for name in asked.names] == [*range(35)]
    place = found[f"{QPOS}/tf"].value
    assert (client.channels[f"{QPOS}/tf"]["schemaName"], place.parent_frame_id) == ("foxglove.FrameTransform", "world")
    assert [place.translation.x, place.translation.y, place.translation.z] == qpos[:3]
    assert [place.rotation.w, place.rotation.x, place.rotation.y, place.rotation.z] == qpos[3:7]
    assert found[GATE].data == gate
    assert found[keys.ESTOP].value == {"value": 0}
    assert found["stranger"].value == {"value": [1, 2]}
    assert found[keys.operator_joints("gello")].value == {"value": [1.5, -2.0]}

    image, points_found = found[f"{HEAD}/image"].value, found[TOP].value
    assert (client.channels[f"{HEAD}/image"]["schemaName"], image.format, image.frame_id) == (
        "foxglove.CompressedImage", "jpeg", "head",
    )  # fmt: skip
    assert image.data == picture
    assert found[TOP].data.endswith(points)
    assert (points_found.frame_id, points_found.point_stride, len(points_found.data)) == ("torso", 12, 1200)
    mark = stamp_of(bus, HEAD)
    assert image.timestamp.ToNanoseconds() == mark.wall_ns - (mark.mono_ns - taken_ns)
    assert points_found.timestamp.ToNanoseconds() == image.timestamp.ToNanoseconds()

    stamped = {f"{STATE}/typed": STATE, GATE: GATE, f"{HEAD}/image": HEAD, TOP: TOP}
    assert {topic: found[topic].log_ns for topic in stamped} == {
        topic: stamp_of(bus, key).wall_ns for topic, key in stamped.items()
    }


def test_every_event_is_a_line_of_a_log_though_all_come_within_a_millisecond(
    start: Start, join: Join, bus: Bus
) -> None:
    bus.publish({keys.EVENT: events.make("g1", "armed").encode()})
    client = join(start(rate_hz=5.0).url())
    client.subscribe(f"{keys.EVENT}/log")
    client.until(lambda: _followed(bus))
    said = [events.make("g1", "fall", "error", lean_rad=1.25), events.make("g1", "disarmed", reason="fall")]
    said += [events.make("g1", f"step-{number}") for number in range(5)]
    for event in said:
        bus.publish({keys.EVENT: event.encode()})
    now_ns = bus.clock.wall_ns()
    heartbeat = Health(
        name="g1", role="low-level", state="active", pid=os.getpid(), host=socket.gethostname(), boot=boot_id(),
        source=bus.source, started_wall_ns=now_ns, wall_ns=now_ns, events=said,
    )  # fmt: skip
    bus.publish({keys.server("g1"): codec.json_object(heartbeat)})
    client.until(lambda: len(client.of(f"{keys.EVENT}/log")) >= len(said))
    found = sorted(client.of(f"{keys.EVENT}/log"), key=lambda one: one.log_ns)
    assert [(one.value.message, one.value.name, one.log_ns) for one in found] == [
        (str(event), event.source, event.wall_ns) for event in said
    ]
    assert [one.value.level for one in found[:2]] == [4, 2]


def _followed(bus: Bus, count: int = 1) -> bool:
    return any(said.name == "foxglove" and said.detail.get("followed") == count for said in read_health(bus))


def test_a_key_that_appears_later_gets_a_channel_and_one_that_is_described_later_another(
    start: Start, join: Join, bus: Bus
) -> None:
    client = join(start().url())
    client.until(lambda: client.channels)
    assert strider.FEET not in client.channels
    bus.publish({strider.FEET: b"[1.5,2.5]"})
    client.subscribe(strider.FEET)
    client.until(lambda: client.of(strider.FEET))
    assert client.of(strider.FEET)[0].value == {"value": [1.5, 2.5]}
    bus.publish({keys.server_config("walker"): codec.json_object(strider.facts())})
    client.subscribe(f"{strider.FEET}/typed")
    assert strider.FEET not in client.channels
    client.until(lambda: client.of(f"{strider.FEET}/typed"))
    value = client.of(f"{strider.FEET}/typed")[0].value
    assert (value.left_force, value.right_force) == (1.5, 2.5)


def test_keys_without_end_cut_no_client_off_and_so_many_are_shown(start: Start, join: Join, bus: Bus) -> None:
    bus.publish({GATE: b'{"n":1}'})
    server = start()
    client = join(server.url(), most_unread=1, receive_bytes=4096)  # behind a slow line
    client.subscribe(GATE)
    long = "z" * 2000  # so that no socket holds it all
    bus.call("MSET", *(part for number in range(MOST_KEYS + 100) for part in (f"{long}-{number}", b"1")))
    wait_until(lambda: "foxglove-keys-left-out" in server.words())
    client.until(lambda: len(client.channels) == MOST_KEYS)
    assert server.words().count("foxglove-keys-left-out") == 1
    bus.publish({GATE: b'{"n":2}'})
    client.until(lambda: client.of(GATE) and client.of(GATE)[-1].value == {"n": 2})


class Monitor:
    """What the bus server is asked, by all its clients."""

    def __init__(self, address: BusAddress) -> None:
        self._line = Connection(address, timeout_s=5.0)
        self._line.call("MONITOR")

    def reads(self, key: str, seconds: float) -> list[str]:
        """Return the requests that read a key, or ask to be told of it, within a time from now on."""
        asked, end_s = [], time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0:
            with contextlib.suppress(TimeoutError):
                asked.append(self._line.receive(left_s).decode(errors="replace"))
        verbs = ('"MGET"', '"GET"', '"SUBSCRIBE"', '"subscribe"')
        return [one for one in asked if key in one and any(verb in one for verb in verbs)]

    def close(self) -> None:
        self._line.close()


def test_nothing_is_read_of_a_key_that_nobody_has_subscribed_to(
    start: Start, join: Join, bus: Bus, bus_server: BusAddress
) -> None:
    bus.publish({HEAD: jpeg(1), GATE: b"{}"})
    server = start()
    url = server.url()
    with contextlib.closing(Monitor(bus_server)) as monitor:
        client = join(url)
        client.subscribe(GATE)
        client.until(lambda: client.of(GATE))
        bus.publish({HEAD: jpeg(2), GATE: b"{}"})
        assert monitor.reads(HEAD, 1.6) == []
        client.subscribe(f"{HEAD}/image")
        client.until(lambda: client.of(f"{HEAD}/image"))
        assert monitor.reads(HEAD, 1.2) != []
        client.unsubscribe(f"{HEAD}/image")
        wait_until(lambda: _followed(bus))
        bus.publish({HEAD: jpeg(3)})
        monitor.reads(HEAD, 0.2)  # what was asked before
        assert monitor.reads(HEAD, 1.6) == []
        client.close()
        wait_until(lambda: _followed(bus, 0))
        assert server.detail()["clients"] == 0


def test_of_values_that_come_faster_than_it_looks_the_newest_is_sent_and_the_others_are_counted(
    start: Start, join: Join, bus: Bus
) -> None:
    bus.publish({GATE: b'{"n":-1}', STATE: b"odd"})
    server = start(rate_hz=1.0)
    client = join(server.url())
    client.subscribe(GATE, f"{STATE}/typed")
    client.until(lambda: client.of(GATE))
    for number in range(50):
        bus.publish({GATE: b'{"n":%d}' % number})
    client.until(lambda: client.of(GATE)[-1].value == {"n": 49})
    wait_until(lambda: server.detail()["sent"] + server.detail()["skipped"] == 51)
    assert server.detail()["skipped"] >= 48
    assert server.detail() | {"sent": 0, "skipped": 0, "channels": 0} == {
        "clients": 1, "channels": 0, "followed": 2, "sent": 0, "skipped": 0, "unfit": 1,
    }  # fmt: skip


def test_a_client_that_never_reads_delays_no_other_and_gets_the_newest_in_the_end(
    start: Start, join: Join, bus: Bus
) -> None:
    size = 400_000
    bus.publish({HEAD: bytes(size), GATE: b'{"n":-1}'})
    server = start()
    url = server.url()
    slow, other = join(url, most_unread=1), join(url)
    slow.subscribe(f"{HEAD}/image")
    slow.until(lambda: slow.of(f"{HEAD}/image"))
    other.subscribe(GATE)
    other.until(lambda: other.of(GATE))
    late_s = []
    for number in range(700):  # 280 MB: more than sockets and queues hold
        bus.publish({HEAD: number.to_bytes(4, "big") + bytes(size), GATE: b'{"n":%d}' % number})
        if number % 10 == 0:
            sent_s = time.monotonic()
            other.until(lambda number=number: other.of(GATE)[-1].value["n"] >= number)  # type: ignore[misc]
            late_s.append(time.monotonic() - sent_s)
        else:
            time.sleep(0.003)
    assert float(np.median(late_s)) < FAST, late_s
    assert len(slow.of(f"{HEAD}/image")) == 1, "it did not read"
    assert _resident_mb(server.process.pid) < 700
    slow.until(lambda: int.from_bytes(slow.messages.pop().value.data[:4], "big") == 699 if slow.messages else False)


def _resident_mb(pid: int) -> float:
    (line,) = (line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1000


def test_it_survives_a_bus_that_is_killed_and_says_so_to_who_looks(tmp_path: Path, processes: None, join: Join) -> None:
    options = ServerOptions(folder=tmp_path / "bus", socket=tmp_path / "bus" / "bus.sock")
    options.folder.mkdir()
    first = RedisServer.start(options)
    with Bus(first.address, name="test", timeout_s=1.0) as bus:
        bus.publish({GATE: b'{"n":1}'})
    with contextlib.closing(Server(first.address, tmp_path)) as server:
        client = join(server.url())
        client.subscribe(GATE)
        client.until(lambda: client.of(GATE))
        os.kill(first.pid, signal.SIGKILL)
        first.stop()
        client.until(lambda: client.statuses)
        assert (client.statuses[0]["op"], client.statuses[0]["id"]) == ("status", "bus")
        with RedisServer.start(options) as second, Bus(second.address, name="test", timeout_s=1.0) as bus:
            client.until(lambda: client.statuses[-1]["op"] == "removeStatus")
            bus.publish({GATE: b'{"n":2}'})
            client.until(lambda: client.of(GATE)[-1].value == {"n": 2})
            bus.publish({keys.RECORDER: b"{}"})
            client.until(lambda: keys.RECORDER in client.channels)
            assert server.process.poll() is None
            server.process.send_signal(signal.SIGINT)
            assert server.process.wait(DEADLINE_S) == 0
            assert "Traceback" not in server.words()


def test_a_client_can_write_nothing(start: Start, join: Join, bus: Bus) -> None:
    bus.publish({keys.ESTOP: b"0"})
    client = join(start().url())
    client.until(lambda: keys.ESTOP in client.channels)
    advertised = {"id": 1, "topic": keys.ESTOP, "encoding": "json", "schemaName": ""}
    client.send({"op": "advertise", "channels": [advertised]})
    client.send({"op": "setParameters", "parameters": [{"name": keys.ESTOP, "value": 1}]})
    client.until(lambda: len(client.statuses) == 2)
    assert all("does not support" in status["message"] for status in client.statuses)
    assert bus.get(keys.ESTOP) == b"0"


def test_a_port_in_use_and_a_host_of_another_machine_end_it_in_one_line(start: Start, bus_server: BusAddress) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        for settings, why in (({"port": port}, "Address already in use"), ({"host": "192.0.2.1"}, "Cannot assign")):
            server = start(**settings)
            assert server.process.wait(DEADLINE_S) == 1
            last = server.words().splitlines()[-1]
            host = settings.get("host", "127.0.0.1")
            assert f"host {host}, port {settings.get('port', 0)}: cannot listen there: {why}" in last
            assert "expected an address of this machine and a port that is free; choose others: --set" in last
            assert "Traceback" not in server.words()


def test_a_port_is_free_again_as_soon_as_the_server_has_ended(start: Start, join: Join) -> None:
    first = start()
    url = first.url()
    client = join(url)
    client.until(lambda: client.channels)
    first.process.send_signal(signal.SIGTERM)
    assert first.process.wait(DEADLINE_S) == 0
    assert start(port=int(url.rpartition(":")[2])).url() == url


def test_an_address_of_the_network_is_said_as_what_it_is(start: Start, bus: Bus) -> None:
    server = start(host="0.0.0.0")
    server.url()
    (event,) = [one for said in read_health(bus) for one in said.events if one.name == "foxglove-open-to-network"]
    assert (event.severity, event.detail["note"]) == (
        "warning", "everybody who reaches it sees every key of the station, pictures too; nobody can write",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"host": " "}, "host is empty; expected an address"),
        ({"port": 70000}, "port is 70000; expected 0 to 65535"),
        ({"rate_hz": 0}, "rate_hz is 0; expected 1 to 500"),
        ({"rate_hz": float("nan")}, "rate_hz is nan; expected 1 to 500"),
        ({"niceness": 20}, "niceness is 20; expected 0 to 19"),
        ({"prot": 1}, "prot"),
    ],
)
def test_a_setting_that_cannot_be_is_named(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        build(FoxgloveConfig, settings, where="test")


def test_without_its_library_it_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    assert KIND.expect is not None
    KIND.expect(FoxgloveConfig())
    monkeypatch.setattr("station.libraries.version", lambda library: None)
    with pytest.raises(StationError) as caught:
        KIND.expect(FoxgloveConfig())
    assert str(caught.value) == (
        "the Foxglove server needs foxglove-sdk, which is not installed; pip install 'teleop-station[foxglove]'"
    )
