from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from adapters.robots.g1 import twist_keys
from servers.recorder import KIND, RecorderConfig
from station import config, registry
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.connection import Connection
from station.bus.redis_server import RedisServer, ServerOptions
from station.episode.reading.listing import list_episodes
from station.episode.reading.reader import open_episode
from station.episode.recorder import remote
from station.episode.storage.manifest import load_manifest
from station.episode.storage.progress import load_resume_point
from station.episode.storage.request import RecorderState, parse_answer
from station.errors import ConfigError, Refused
from tests.waiting import wait_until

BODY = twist_keys.action_body()

SERVE = """
import sys
from servers.recorder import KIND, RecorderConfig
from station import config
from station.bus.address import parse
from station.life.serving import serve
import msgspec
values = msgspec.json.decode(sys.argv[2])
sys.exit(serve(KIND, config.build(RecorderConfig, values, where="test"), address=parse(sys.argv[1]), name=sys.argv[3]))
"""

Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="g1", timeout_s=5.0) as line:
        yield line


@pytest.fixture
def recorder(bus_server: BusAddress, bus: Bus, tmp_path: Path) -> Iterator[Start]:
    """Starts recorder processes and waits until each says what it is doing; none outlives the test."""
    children: list[subprocess.Popen[str]] = []

    def start(
        *, name: str = "recorder", wait: bool = True, is_cold: bool = False, **values: Any
    ) -> subprocess.Popen[str]:
        settings = {"data": str(tmp_path), "min_free_mb": 0, "preroll_s": 0, **values}
        child = subprocess.Popen(
            [sys.executable, "-c", SERVE, bus_server.url, msgspec.json.encode(settings).decode(), name],
            stderr=subprocess.PIPE, text=True, env=os.environ | ({"PYTHONHASHSEED": "0"} if is_cold else {}),
        )  # fmt: skip
        children.append(child)
        if wait:
            wait_until(lambda: child.poll() is not None or state(bus) is not None)
            assert child.poll() is None, child.communicate()[1]
        return child

    yield start
    for child in children:
        child.kill()
        child.communicate()


def state(bus: Bus) -> RecorderState | None:
    value = bus.get(keys.RECORDER)
    return msgspec.json.decode(value, type=RecorderState) if value else None


def publish(bus: Bus, count: int, first: int = 0) -> None:
    for n in range(first, first + count):
        assert bus.publish({BODY: codec.json_vector([float(n)] * 35), keys.robot_state("g1"): n.to_bytes(8, "little")})


def numbers(path: Path, topic: str = BODY) -> list[int]:
    return [m.sequence for m in open_episode(path).messages([topic]) if m.channel.writer == "g1"]


def test_every_write_is_recorded_once_in_order_and_byte_for_byte(
    recorder: Start, bus: Bus, bus_server: BusAddress
) -> None:
    process = recorder()
    begun = remote.ask(bus, "start", task="walk", operator={"id": "ab"})
    plain = Connection(bus_server, timeout_s=5.0)
    images = [os.urandom(60_000) for _ in range(20)]
    for n in range(1000):
        bus.publish({BODY: codec.json_vector([float(n)] * 35)})
        if n % 50 == 0:
            plain.call("SET", "camera", images[n // 50])
            plain.call("SET", BODY, b"[%d]" % n)
    plain.call("DEL", "camera")
    plain.close()
    ended = remote.ask(bus, "stop", success=True)
    reader = open_episode(Path(ended.path or ""))
    body = list(reader.messages([BODY], stamps=True))
    native = [m for m in body if m.channel.is_native]
    assert [m.sequence for m in native] == list(range(1, 1001))
    assert [m.data for m in native] == [codec.json_vector([float(n)] * 35) for n in range(1000)]
    assert all(m.stamp is not None and m.stamp.endswith(bus.source.encode()) for m in native)
    assert [m.data for m in body if not m.channel.is_native] == [b"[%d]" % n for n in range(0, 1000, 50)]
    assert [m.data for m in reader.messages(["camera"])] == [*images, b""]
    assert (begun.episode_id, ended.summary["lost"], ended.summary["dropped"]) == (ended.episode_id, 0, 0)
    assert ended.summary["messages"] == sum(stream.count for stream in reader.streams())
    assert reader.manifest.recorder.backend == "replication"
    assert [event.name for event in reader.manifest.events][:1] == ["record-start"]
    process.send_signal(signal.SIGTERM)
    assert process.wait(60) == 0
    assert state(bus) is None


def test_no_write_waits_for_a_library_that_is_loaded(recorder: Start, bus: Bus) -> None:
    process = recorder(is_cold=True)  # as a user's: one that the tests start has NumPy from the beginning
    loaded = libraries(process.pid)
    folder = Path(remote.ask(bus, "start", task="walk").path or "")
    publish(bus, 10)
    bus.publish({"something_else": b"1", keys.action_joints("arm"): b"[1]"})
    remote.ask(bus, "stop")
    assert numbers(folder) == list(range(1, 11))
    assert libraries(process.pid) - loaded == set()


def libraries(pid: int) -> set[str]:
    """Return the compiled libraries that a process has loaded; NumPy is made of several."""
    rows = Path(f"/proc/{pid}/maps").read_text().splitlines()
    return {row.split(maxsplit=5)[5] for row in rows if ".so" in row}


def test_a_recorder_killed_in_mid_episode_leaves_what_it_has_flushed(recorder: Start, bus: Bus) -> None:
    process = recorder()
    begun = remote.ask(bus, "start", task="walk")
    folder = Path(begun.path or "")
    done = threading.Event()

    def write() -> None:
        n = 0
        while not done.wait(0.002):
            n += 1
            publish(bus, 1, n)

    thread = threading.Thread(target=write)
    thread.start()
    # Far less than a chunk: a file cut by size would hold nothing.
    wait_until(lambda: (saved := load_resume_point(folder)) is not None and saved.messages > 100)
    process.kill()
    process.wait()
    done.set()
    thread.join()
    reader = open_episode(folder)
    assert reader.is_active
    assert reader.manifest.state == "recording"
    found = numbers(folder)
    assert found == list(range(1, len(found) + 1))
    assert len(found) > 10
    assert [row.state for row in list_episodes(folder.parent.parent)] == ["unfinished"]
    point = load_resume_point(folder)
    assert point is not None
    assert point.position is not None
    assert point.messages <= sum(1 for _ in reader.messages())


def test_ending_the_recorder_closes_its_episode(recorder: Start, bus: Bus) -> None:
    process = recorder(task="squat")
    begun = remote.ask(bus, "start")
    publish(bus, 100)
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 0
    manifest = load_manifest(Path(begun.path or ""))
    assert (manifest.state, manifest.recorder.ended_by, manifest.task.name) == ("finished", "shutdown", "squat")
    assert numbers(Path(begun.path or "")) == list(range(1, 101))


def test_who_looks_too_late_for_an_answer_finds_it_behind_the_next(recorder: Start, bus: Bus) -> None:
    recorder()
    remote.ask(bus, "start")
    for asker in ("a", "b"):
        bus.publish({keys.RECORD: codec.json_object({"id": asker, "action": "mark", "label": asker})})
    wait_until(lambda: parse_answer(bus.get(keys.RECORD_ACK) or b"", "b") is not None)
    newest = bus.get(keys.RECORD_ACK) or b""
    assert [getattr(parse_answer(newest, asker), "ok", None) for asker in ("a", "b")] == [True, True]


def test_a_second_recorder_gets_one_line(recorder: Start, tmp_path: Path) -> None:
    first = recorder()
    second = recorder(name="second", wait=False)
    third = recorder(name="third", wait=False, data=str(tmp_path / "elsewhere"))
    for child, words in ((second, f"data folder {tmp_path}"), (third, "bus unix://")):
        last_words = child.communicate(timeout=30)[1]
        assert child.returncode != 0
        assert f"{words}" in last_words
        assert f"another recorder (pid {first.pid}) is at work" in last_words
    assert first.poll() is None


def test_a_tap_that_is_cut_goes_on_without_a_hole(recorder: Start, bus: Bus, bus_server: BusAddress) -> None:
    recorder()
    begun = remote.ask(bus, "start")
    publish(bus, 200)
    admin = Connection(bus_server, timeout_s=5.0)
    assert admin.call("CLIENT", "KILL", "TYPE", "replica") >= 1
    admin.close()
    publish(bus, 200, 200)

    def is_back() -> bool:
        names = [event.name for event in load_manifest(Path(begun.path or "")).events]
        return "tap-resumed" in names

    wait_until(is_back)
    remote.ask(bus, "stop")
    path = Path(begun.path or "")
    assert numbers(path) == list(range(1, 401))
    assert load_manifest(path).holes == []


def test_a_bus_that_is_restarted_leaves_a_hole_that_is_noted(
    tmp_path: Path, recorder: Start, bus_server: BusAddress
) -> None:
    folder = tmp_path / "own-bus"
    folder.mkdir()
    options = ServerOptions(folder=folder, socket=folder / "bus.sock")
    server = RedisServer.start(options)
    try:
        with Bus(server.address, name="g1", timeout_s=5.0) as bus:
            child = subprocess.Popen(
                [sys.executable, "-c", SERVE, server.address.url,
                 msgspec.json.encode({"data": str(tmp_path), "min_free_mb": 0, "resume_s": 30}).decode(), "recorder"]
            )  # fmt: skip
            try:
                wait_until(lambda: state(bus) is not None)
                begun = remote.ask(bus, "start")
                publish(bus, 50)
                wait_until(lambda: (found := state(bus)) is not None and found.messages > 100)
                server.stop()
                server = RedisServer.start(options)
                wait_until(lambda: bus.publish({"hello": b"1"}))
                wait_until(lambda: bool(load_manifest(Path(begun.path or "")).holes))
                publish(bus, 50)
                ended = remote.ask(bus, "stop")
            finally:
                child.terminate()
                child.wait(60)
    finally:
        server.stop()
    manifest = load_manifest(Path(ended.path or ""))
    assert ended.episode_id == begun.episode_id
    assert "could not go on where it was" in manifest.holes[0].reason
    assert manifest.holes[0].lost is not None
    assert ended.summary["holes"] == 1
    assert len(numbers(Path(ended.path or ""))) == 100


def test_a_refusal_reaches_the_one_who_asked(recorder: Start, bus: Bus) -> None:
    recorder(min_free_mb=1e12)
    with pytest.raises(Refused, match="MB free, at least"):
        remote.ask(bus, "start")
    with pytest.raises(Refused, match="nothing to stop"):
        remote.ask(bus, "stop")


def test_the_other_taps_are_named_in_the_manifest(recorder: Start, bus: Bus) -> None:
    recorder(backend="notifications")
    begun = remote.ask(bus, "start")
    publish(bus, 5)
    remote.ask(bus, "stop")
    manifest = load_manifest(Path(begun.path or ""))
    assert (manifest.recorder.backend, manifest.recorder.is_lossless) == ("notifications", False)


def test_the_recorder_is_registered_and_its_configuration_is_checked(tmp_path: Path) -> None:
    assert registry.find("server", "recorder") is KIND
    assert config.build(RecorderConfig, {"data": str(tmp_path)}, where="x").options.data == tmp_path
    for values, words in (
        ({"preroll_s": -1}, "preroll_s is -1"),
        ({"flush_s": 0}, "flush_s is 0"),
        ({"prerol_s": 1}, "did you mean 'preroll_s'"),
        ({"backend": "monitor"}, "expected notifications or poll or replication, got 'monitor'"),
    ):
        with pytest.raises(ConfigError, match=f"(?i){words}"):
            config.build(RecorderConfig, values, where="x")
