"""The cues server as a process of its own on a real bus: what an operator hears of what others say there."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from servers.cues import CuesConfig
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.config import build
from station.errors import ConfigError
from station.life import events
from station.life.server import DEAD_AFTER_S, read_health
from tests.adapters.cues.programs import calls, put
from tests.servers.device_station import RUN
from tests.servers.g1_station import Log, logged
from tests.waiting import DEADLINE_S, wait_until

TAKE = "2026-11-21-g1-walk-0007"
Start = Callable[..., subprocess.Popen[bytes]]


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="test", timeout_s=5.0) as client:
        yield client


@pytest.fixture
def said(tmp_path: Path) -> Callable[[], list[str]]:
    """What a speech program was asked to say so far."""
    log = put(tmp_path / "bin", "espeak-ng")
    return lambda: [arguments[-1] for arguments in calls(log)]


@pytest.fixture
def start(bus_server: BusAddress, bus: Bus, tmp_path: Path) -> Iterator[Start]:
    """Starts the server and waits until it listens; what still runs at the end is killed."""
    started: list[subprocess.Popen[bytes]] = []

    def begin(*, waits: bool = True, **config: Any) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-c", RUN, "cues", bus_server.url, json.dumps(config)]
        environment = {**os.environ, "PATH": str(tmp_path / "bin"), "SDL_AUDIODRIVER": "alsa",
                       "ALSA_CONFIG_PATH": "/nowhere"}  # fmt: skip
        with (tmp_path / "stderr").open("wb") as stderr:
            process = subprocess.Popen(command, cwd=tmp_path.parents[0], env=environment, stderr=stderr)
        started.append(process)
        if waits:
            wait_until(lambda: process.poll() is not None or "said" in detail(bus))
            assert process.poll() is None, (tmp_path / "stderr").read_text()
        return process

    yield begin
    for process in started:
        process.kill()
        process.wait()


def tell(bus: Bus, source: str, name: str, **numbers: Any) -> None:
    """Say an event as a server does."""
    bus.publish({keys.EVENT: events.make(source, name, **numbers).encode()})


def detail(bus: Bus) -> dict[str, Any]:
    return next((health.detail for health in read_health(bus) if health.name == "cues"), {})


def test_an_operator_hears_what_happens_and_stops_the_server(
    start: Start, bus: Bus, said: Callable[[], list[str]]
) -> None:
    process = start(voices=["speech"])
    reason = "pico is lost: no headset yet"
    told = [
        ("teleop", "operator-refused", {"reason": f"{reason}; put it on"}, f"refused: {reason}"),
        ("teleop", "operator-engaged", {}, "engaged"),
        ("recorder", "record-start", {"episode_id": TAKE}, "recording take 7"),
        ("recorder", "mark", {"episode_id": TAKE, "label": "mark"}, "marked"),
        ("recorder", "disk-low", {"minutes_left": 8.4}, "disk low, 8.4 minutes left"),
        ("recorder", "record-stop", {"episode_id": TAKE, "discarded": True}, "take 7 discarded"),
        ("g1", "armed", {}, "armed"),
        ("teleop", "operator-disengaged", {"reason": "released"}, "released"),
    ]
    heard: list[str] = []
    for who, name, numbers, words in told:
        tell(bus, who, name, **numbers)
        heard.append(words)
        wait_until(lambda: said() == heard)
    wait_until(lambda: detail(bus)["said"] == len(heard))
    assert (detail(bus)["dropped"], detail(bus)["broken_off"]) == (0, 0)
    process.send_signal(signal.SIGTERM)
    assert process.wait(DEADLINE_S) == 0


def test_a_stop_interrupts_whoever_presses_it_and_is_told_once(start: Start, bus: Bus, tmp_path: Path) -> None:
    endless = 'while "engaged" in sys.argv: time.sleep(0.05)'
    log = put(tmp_path / "bin", "espeak-ng", then=endless)
    start(voices=["speech"])
    tell(bus, "teleop", "operator-engaged")
    wait_until(lambda: calls(log))
    bus.call("SET", keys.ESTOP, b"1")
    tell(bus, "g1", "estop", reason="emergency stop")
    wait_until(lambda: len(calls(log)) > 1)
    tell(bus, "teleop", "operator-mode", mode="walk")
    wait_until(lambda: len(calls(log)) > 2)
    assert [arguments[-1] for arguments in calls(log)] == ["engaged", "emergency stop", "walk"]
    wait_until(lambda: detail(bus)["broken_off"] == 1)


def test_a_robot_whose_server_is_killed_with_nobody_to_say_so_is_heard(
    start: Start, bus: Bus, said: Callable[[], list[str]]
) -> None:
    robot = "import sys, time; sys.argv[1:] = [sys.argv[1]]\n" + ROBOT
    process = subprocess.Popen([sys.executable, "-c", robot, bus.address.url])
    try:
        start(voices=["speech"])
        wait_until(lambda: any(health.name == "g1" and health.state == "active" for health in read_health(bus)))
        told_s = DEAD_AFTER_S  # two heartbeats heard, then silence
        beats = {health.wall_ns for health in read_health(bus) if health.name == "g1"}
        wait_until(lambda: beats.update(h.wall_ns for h in read_health(bus) if h.name == "g1") or len(beats) > 3)
        process.kill()
        wait_until(lambda: said() == ["g1 died"], DEADLINE_S + told_s)
    finally:
        process.kill()
        process.wait()


ROBOT = """
import msgspec
from station.bus.address import parse
from station.life.server import ServerKind
from station.life.serving import serve
class Nothing(msgspec.Struct, frozen=True): pass
def main(config, life):
    life.ready()
    life.stop_event.wait()
    return 0
kind = ServerKind(name="g1", role="low-level", summary="", config=Nothing, main=main)
serve(kind, Nothing(), address=parse(sys.argv[1]))
"""


def test_a_voice_that_fails_is_an_event_and_the_others_go_on(start: Start, bus: Bus, tmp_path: Path) -> None:
    put(tmp_path / "bin", "espeak-ng", then='sys.exit("no card")')
    with logged(bus.address) as log:
        start(voices=["speech", "wav"], options={"wav": {"file": str(tmp_path / "cues.wav")}}, old_s=60)
        tell(bus, "teleop", "operator-engaged")
        wait_until(lambda: (tmp_path / "cues.txt").read_text().endswith("\tengaged\n"))
        wait_until(lambda: flaws(log) == [{"voice": "speech", "reason": "espeak-ng ended with exit code 1: no card"}])


def flaws(log: Log) -> list[dict[str, Any]]:
    """What the server told of cues that were not said."""
    return [event.detail for event in log.events("cue-not-said")]


def test_after_a_cue_that_could_not_be_broken_off_the_next_is_said(start: Start, bus: Bus, tmp_path: Path) -> None:
    hangs = 'while "engaged" in sys.argv or "--cancel" in sys.argv: time.sleep(0.05)'
    log = put(tmp_path / "bin", "spd-say", then=hangs)
    reason = "`spd-say --cancel` has not ended within 1 s; does its sound service run?"
    with logged(bus.address) as told:
        start(voices=["speech"], old_s=60)
        tell(bus, "teleop", "operator-engaged")
        wait_until(lambda: calls(log))
        tell(bus, "g1", "estop", reason="emergency stop")
        wait_until(lambda: flaws(told) == [{"voice": "speech", "reason": reason}])
        wait_until(lambda: [arguments[-1] for arguments in calls(log)][2:] == ["emergency stop"])


def test_a_file_of_the_lab_is_heeded(start: Start, bus: Bus, tmp_path: Path, said: Callable[[], list[str]]) -> None:
    (tmp_path / "lab.yaml").write_text("operator-engaged: los gehts\nmark: none\n")
    start(voices=["speech"], phrases=str(tmp_path / "lab.yaml"))
    for name, words in (("operator-engaged", "los gehts"), ("mark", ""), ("armed", "armed")):
        tell(bus, "somebody", name)
        wait_until(lambda: not words or words in said())  # noqa: B023
    assert said() == ["los gehts", "armed"]


@pytest.mark.parametrize(
    ("config", "code", "complaint"),
    [
        (
            {"voices": ["speech"]},
            1,
            "no program to speak with: none of espeak-ng, espeak, spd-say, say on the path; install one",
        ),
        ({"voices": ["tones"]}, 1, "no sound output ("),
        ({"voices": ["wav"], "phrases": "/none.yaml"}, 2, "/none.yaml: no such file"),
    ],
)
def test_what_is_missing_ends_in_one_line(
    start: Start, tmp_path: Path, config: dict[str, Any], code: int, complaint: str
) -> None:
    assert start(waits=False, **config).wait(DEADLINE_S) == code
    lines = (tmp_path / "stderr").read_text().splitlines()
    assert len(lines) == 1, lines
    assert complaint in lines[0]


@pytest.mark.parametrize(
    ("config", "complaint"),
    [
        ({"voices": []}, "voices: expected different names, got none"),
        ({"voices": ["wav", "wav"]}, "voices: expected different names"),
        ({"voices": ["horn"]}, "unknown voice 'horn'; known: speech, tones, wav"),
        ({"voices": ["wav"], "options": {"tones": {}}}, "options: tones is none of the voices"),
        ({"voices": ["wav"], "options": {"wav": {"fiel": "x.wav"}}}, r"unknown key 'fiel' \(did you mean 'file'\?\)"),
        ({"voices": ["speech"], "options": {"speech": {"program": "sing"}}}, "expected one of espeak-ng"),
        ({"voices": ["speech"], "options": {"speech": {"voice": "-x"}}}, "expected the name of a voice"),
        ({"voices": ["tones"], "options": {"tones": {"volume": 2}}}, "volume is 2; expected more than 0, up to 1"),
        ({"old_s": 0}, "old_s is 0; expected 0.5 to 60 s"),
        ({"voice": "tones"}, r"unknown key 'voice' \(did you mean 'voices'\?\)"),
    ],
)
def test_a_wrong_configuration_is_refused_by_name(config: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        build(CuesConfig, config, where="test")


def test_cues_are_off_until_somebody_starts_them() -> None:
    from station.supervision import runbook

    for path in sorted(Path("runbooks").glob("*.yaml")):
        assert "cues" not in [step.start for step in runbook.load(path).servers]
