"""The Pico server as a process of its own: the real library, a fake PC service under it, and a real bus."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from itertools import count, dropwhile
from pathlib import Path
from typing import Any

import pytest

from adapters.devices.fakes.pico.service import PicoService
from adapters.devices.pico.kind import PicoConfig
from adapters.robots.g1 import twist_keys
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.tap import open_tap
from station.config import build
from station.errors import ConfigError
from station.life.events import Event
from station.life.restarts import Restarts
from station.supervision.supervisor import Supervisor
from tests.adapters.devices.pico.frames import frame
from tests.operator.account import Account
from tests.waiting import DEADLINE_S, is_running, wait_until

RUN = """
import json, sys
from adapters.devices.pico.kind import KIND, PicoConfig
from station.bus.address import parse
from station.config import build
from station.errors import StationError
from station.life.serving import serve
try:
    sys.exit(serve(KIND.server, build(PicoConfig, json.loads(sys.argv[2]), where="test"), address=parse(sys.argv[1])))
except StationError as error:
    sys.stderr.write(str(error))
    sys.exit(error.exit_code)
"""
NO_LIBRARY = "import sys; sys.modules['xrobotoolkit_sdk'] = None\n"
Start = Callable[..., subprocess.Popen[bytes]]
SHAKE_M = 1e-3
HEAD = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
STOCK_HAND = {"index_trig": float, "grip": float, "key_one": bool, "key_two": bool, "axis": list, "axis_click": bool}


def at(x: float) -> list[float]:
    return [x, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]


@pytest.fixture
def start(bus_server: BusAddress, tmp_path: Path) -> Iterator[Start]:
    """Starts the server, on a script where one is given; what still runs at the end is killed."""
    started: list[subprocess.Popen[bytes]] = []

    def begin(script: Mapping[str, Any] | None = None, *, before: str = "", **config: Any) -> subprocess.Popen[bytes]:
        if script is not None:
            config["fake"] = str(tmp_path / "script.json")
            Path(config["fake"]).write_text(json.dumps(script))
        command = [sys.executable, "-c", before + RUN, bus_server.url, json.dumps(config)]
        with (tmp_path / "stderr").open("wb") as stderr:
            started.append(subprocess.Popen(command, stderr=stderr))
        return started[-1]

    yield begin
    for process in started:
        process.kill()
        process.wait()


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="test", timeout_s=5.0) as client:
        yield client


@pytest.fixture
def account(bus_server: BusAddress) -> Iterator[Account]:
    tap = open_tap(bus_server)
    yield Account(tap)
    tap.close()


def stderr(folder: Path) -> str:
    return (folder / "stderr").read_text()


def test_a_scripted_session_stands_on_the_bus_sample_by_sample(start: Start, account: Account) -> None:
    """The hand goes three metres forward within three seconds: its place tells the time. Meanwhile a button is
    pressed."""
    poses = [{"at_s": 0.0, "head": HEAD, "left": at(0.0), "right": at(0.0)}, {"at_s": 3.0, "right": at(3.0)}]
    start({"frames": poses, "controls": [{"at_s": 0.5, "press": "right_primary", "for_s": 2.0},
                                         {"at_s": 0.2, "set": {"left_stick_y": 0.5}}]})  # fmt: skip
    account.until(lambda: len(account.samples()) > 270)
    samples = account.samples()
    forward = [sample.right.position[0] for sample in samples if sample.right is not None]
    assert forward == sorted(forward, key=lambda x: round(x, 3)), "it only goes forward"
    assert forward[0] < forward[-1] == pytest.approx(3.0, abs=1e-4)
    pressed = [x for x, sample in zip(forward, samples, strict=True) if sample.controls["right_primary"] == 1.0]
    released = [x for x, sample in zip(forward, samples, strict=True) if sample.controls["right_primary"] == 0.0]
    assert pressed, "at least one of a hundred and forty"
    assert all(0.5 - SHAKE_M < x < 2.5 + SHAKE_M for x in pressed)
    assert not any(0.5 + SHAKE_M < x < 2.5 - SHAKE_M for x in released)
    assert samples[-1].controls["left_stick_y"] == 0.5


def test_each_sample_is_one_write_with_its_time_of_capture_and_never_a_second_one(
    start: Start, account: Account
) -> None:
    start({"motion": "builtin:wave", "rate_hz": 50.0})
    account.until(lambda: len(account.samples()) > 60)
    captured = [sample.capture_ns for sample in account.samples()]
    assert captured == sorted(set(captured), key=lambda ns: ns or 0)
    whole = {"controls", "head", "left", "right", "body_pos", "body_quat"}
    for tick in account.ticks:
        assert tick.status is not None
        assert len({(mark.mono_ns, mark.source) for mark in tick.stamps if mark is not None}) == 1
        assert {mark.capture_ns for mark in tick.stamps if mark is not None} == {tick.status.capture_ns}
        if tick.reading is None:
            own = {keys.operator_status("pico"), twist_keys.CONTROLLER_DATA}
            assert set(tick.values) == own, "what it held is repeated for stock readers only"
        else:
            assert set(tick.status.parts) == whole
            assert twist_keys.CONTROLLER_DATA in tick.values, "stock writes it a hundred times a second"
    news = [tick.status.new for tick in account.ticks if tick.status is not None and tick.reading is not None]
    assert news == list(range(1, len(news) + 1))
    last = account.status()
    assert last.repeated > 0, "100 looks for 50 samples"


def test_stock_readers_find_their_controllers(start: Start, account: Account) -> None:
    start({"controls": [{"at_s": 0.0, "set": {"left_secondary": 1.0, "right_grip": 0.25}}]})
    account.until(lambda: len(account.samples()) > 10)
    data = json.loads([tick for tick in account.ticks if tick.reading][-1].values[twist_keys.CONTROLLER_DATA])
    assert set(data) == {"LeftController", "RightController", "timestamp"}
    assert {name: type(value) for name, value in data["LeftController"].items()} == STOCK_HAND
    assert data["LeftController"]["key_two"] is True
    assert data["RightController"]["grip"] == 0.25
    assert isinstance(data["timestamp"], int)


def test_silence_and_a_service_that_dies_are_told_and_over_when_they_are_over(start: Start, account: Account) -> None:
    faults = [{"at_s": 1.0, "kind": "silence", "for_s": 0.4}, {"at_s": 2.5, "kind": "crash", "for_s": 2.0}]
    start({"faults": faults})
    died = "no headset any more: no PC service answers at 127.0.0.1:"

    def since_it_died() -> list[Event]:
        """Return what was told since the service is known to have died."""
        return list(dropwhile(lambda event: not str(event.detail.get("reason", "")).startswith(died), account.events))

    account.until(lambda: "operator-live" in [event.name for event in since_it_died()])
    lost = since_it_died()[0]
    assert lost.name == "operator-lost"
    assert lost.detail["silent_s"] >= 1.0
    before = [event.name for event in account.events[: account.events.index(lost)] if "operator-" in event.name]
    silent = before.index("operator-stale", before.index("operator-live"))
    assert "operator-live" in before[silent:], "a short silence is over by itself"
    assert before[-1] in ("operator-stale", "operator-lost"), "silence comes first"
    assert {tick.status.state for tick in account.ticks if tick.status is not None} == {"live", "stale", "lost"}


def test_one_time_stamp_for_ever_is_silence_though_frames_come(start: Start, account: Account) -> None:
    controls = [{"at_s": 0.0, "press": "left_secondary", "for_s": 60.0}]
    start({"controls": controls, "faults": [{"at_s": 0.5, "kind": "freeze", "for_s": 2.0}]})
    account.until(lambda: account.states()[-4:] == ["live", "stale", "lost", "live"])
    stamps = [sample.capture_ns for sample in account.samples()]
    assert len(stamps) == len(set(stamps))
    pressed = {True: set[str](), False: set[str]()}
    for tick in account.ticks:
        data = json.loads(tick.values[twist_keys.CONTROLLER_DATA])
        pressed[data["LeftController"]["key_two"]].add(tick.status.state if tick.status else "")
    assert pressed == {True: {"live", "stale"}, False: {"lost"}}, "no button stays pressed on a device that is lost"


def names_since(account: Account, name: str) -> list[str]:
    """Return the names of the events from the first of a name on."""
    names = [event.name for event in account.events]
    return names[names.index(name) :] if name in names else []


def test_a_library_that_aborts_takes_its_server_down_and_the_supervisor_brings_both_back(
    bus_server: BusAddress, account: Account, tmp_path: Path
) -> None:
    script = tmp_path / "script.json"
    controls = [{"at_s": 0.0, "set": {"left_trigger": 0.25}, "for_s": 1.0}]
    script.write_text(json.dumps({"controls": controls, "faults": [{"at_s": 1.0, "kind": "poison"}]}))
    with Bus(bus_server, name="supervisor", timeout_s=5.0) as bus:
        supervisor = Supervisor(bus, tmp_path / "logs")
        try:
            supervisor.spawn("pico", PicoConfig(fake=script), restarts=Restarts())
            supervisor.wait_for("pico", "inactive", DEADLINE_S)
            supervisor.activate("pico")
            account.until(lambda: "operator-live" in names_since(account, "server-restarted"))
            deaths = [event for event in account.events if event.name == "server-restarted"]
            assert [event.detail["server"] for event in deaths] == ["pico"]
            assert (
                f"signal {int(signal.SIGABRT)}" in deaths[0].detail["reason"] or "SIGABRT" in deaths[0].detail["reason"]
            )
            assert account.samples()[0].controls["left_trigger"] == 0.25
            assert account.samples()[-1].controls["left_trigger"] == 0.0, "the script goes on and does not begin again"
        finally:
            assert supervisor.stop("pico") == 0
            supervisor.stop_all()


def test_without_a_service_it_says_so_in_a_line_and_waits(start: Start, account: Account, bus: Bus) -> None:
    with PicoService(0) as service:
        port = service.port
        service.stop()
        process = start(port=port)
        account.until(lambda: account.states() == ["lost"])
        reason = account.events[-1].detail["reason"]
        assert reason == (
            f"no headset yet: no PC service answers at 127.0.0.1:{port}; start XRoboToolkit's PC Service there"
        )
        account.until(lambda: account.status().reason == reason)
        service.start()
        assert service.wait_for_listener(DEADLINE_S)
        stamps = count(1_000_000_000, 10_000_000)

        def is_live() -> bool:
            service.send(frame(next(stamps)))
            return account.states()[-1] == "live"

        account.until(is_live)
        process.send_signal(signal.SIGTERM)
        assert process.wait(DEADLINE_S) == 0
    account.until(lambda: account.status().reason == "the device server has ended")
    assert account.status().state == "lost"


def test_without_the_library_it_ends_in_a_line_that_names_the_extra(start: Start, tmp_path: Path) -> None:
    assert start(before=NO_LIBRARY).wait(DEADLINE_S) == 1
    assert "pip install 'teleop-station[pico]'" in stderr(tmp_path)
    assert len(stderr(tmp_path).splitlines()) == 1


@pytest.mark.parametrize(
    ("script", "complaint"),
    [
        ({"contrls": []}, "unknown field 'contrls' (did you mean 'controls'?)"),
        ({"controls": [{"at_s": 1.0, "press": "rigth_primary"}]}, "controls[0]: no control 'rigth_primary'"),
        ({"faults": [{"at_s": 1.0, "kind": "fire"}]}, "faults[0].kind: invalid enum value 'fire'"),
    ],
)
def test_a_bad_script_ends_in_a_line_with_file_and_field(
    start: Start, tmp_path: Path, script: Mapping[str, Any], complaint: str
) -> None:
    assert start(script).wait(DEADLINE_S) == 2
    assert stderr(tmp_path).startswith(f"{tmp_path / 'script.json'}: {complaint}")
    assert len(stderr(tmp_path).splitlines()) == 1


def test_the_fake_service_does_not_outlive_its_server(start: Start, account: Account) -> None:
    process = start({})
    account.until(account.samples)
    children = [int(pid) for pid in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()]
    assert len(children) == 1
    os.kill(process.pid, signal.SIGKILL)
    wait_until(lambda: not is_running(children[0]))


@pytest.mark.parametrize(
    ("config", "complaint"),
    [
        ({"rate_hz": 5}, "rate_hz is 5; expected 10 to 500 Hz"),
        ({"port": 0}, "port is 0; expected 1 to 65535"),
        ({"address": "my pc"}, "address is 'my pc'; expected a host name"),
        ({"fakee": "x.json"}, "unknown key 'fakee'"),
    ],
)
def test_a_wrong_configuration_is_refused_by_name(config: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        build(PicoConfig, config, where="test")
