"""What somebody who looks on is told of a run, from what stands on the bus."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from adapters.robots.g1 import twist_keys
from adapters.robots.kassow.names import KR810_ROBOT
from station.bus import codec, keys, stamp
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.contract import TIMING_STAGES
from station.episode.storage.request import RecorderState
from station.life.server import Health
from station.view import progress_panel
from station.view.progress import Progress, ProgressReader
from tests.waiting import DEADLINE_S

ROBOT = twist_keys.TWIST2_ROBOT
NAMES = ("g1", "recorder", "motion")
ROLES = {"g1": "low-level", "recorder": "recorder", "motion": "command"}
PARTS = [{"name": "wave", "start_s": 0.0, "end_s": 6.0}, {"name": "bow", "start_s": 6.0, "end_s": 20.0}]

ALIVE_NS = round(DEADLINE_S * 1e9)
"""So much later than it is said was a server heard: it lives for all of a test, however slow the machine is."""


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="test", timeout_s=5.0) as line:
        yield line


def say(bus: Bus, name: str, state: str, **detail: Any) -> None:
    health = Health(
        name=name, role=ROLES[name], state=state, pid=os.getpid(), host=socket.gethostname(), boot=stamp.boot_id(),
        source=bus.source, started_wall_ns=time.time_ns(), wall_ns=time.time_ns() + ALIVE_NS, rate_hz=50.0,
        detail=detail,
    )  # type: ignore[arg-type]  # fmt: skip
    bus.publish({keys.server(name): codec.json_object(health)})


def play(bus: Bus, *, tilt_rad: float = 0.1, phase: str = "playing") -> None:
    """What a whole station writes in one tick."""
    for name in NAMES:
        say(bus, name, "active", **({"falls": 1} if name == "g1" else {}))
    motion = {"file": "builtin:tour", "duration_s": 20.0, "clips": PARTS}
    timing = [7, 8, *(1_000_000 * instant for instant in (1000, 1001, 1008, 1009, 1011, 1012))]
    qpos = [1.0, 2.0, 0.75, np.cos(tilt_rad / 2), np.sin(tilt_rad / 2), 0.0, 0.0, *np.zeros(29)]
    bus.publish(
        {
            keys.server_config("g1"): codec.json_object({"robot": ROBOT, "policy": {"name": "tracker"}}),
            keys.server_config("motion"): codec.json_object({"robot": ROBOT, "motion": motion}),
            keys.sim_qpos(ROBOT): codec.f64(qpos),
            keys.policy_timing(ROBOT): codec.json_vector(timing),
            keys.command_gate(ROBOT): codec.json_object({"state": "tracking"}),
            keys.command_source(ROBOT): codec.json_object({"phase": phase, "time_s": 7.5}),
            keys.RECORDER: codec.json_object(RecorderState(state="recording", messages=12345, bytes=2_000_000)),
        }
    )


def shown(progress: Progress, step: str = "", died: dict[str, str] | None = None) -> str:
    console = Console(width=100, record=True, file=open(os.devnull, "w"))  # noqa: SIM115  closed with the process
    with console.capture() as captured:
        console.print(progress_panel.panel(progress, NAMES, step, died))
    console.file.close()
    return captured.get()


def test_a_run_is_told_from_motion_to_recorder(bus: Bus) -> None:
    assert len(TIMING_STAGES) == 6
    play(bus)
    seen = ProgressReader(bus, NAMES).poll()
    assert seen.motion is not None
    assert (seen.motion.name, seen.motion.clip, seen.motion.duration_s) == ("tour", "bow", 20.0)
    assert seen.robot is not None
    assert seen.robot.tilt_rad == pytest.approx(0.1)
    assert seen.robot.height_m == 0.75
    assert seen.policy is not None
    assert seen.policy.inference_s == pytest.approx(0.002)
    assert seen.policy.latency_s == pytest.approx(0.012)
    text = shown(seen)
    for part in ("7.5 / 20.0 s", "tour: bow", "upright", "5.7°", "0.75 m", "1 fall", "tracker   50.0 Hz",
                 "inference 2.00 ms", "command to joints 12.0 ms", "12 345 messages", "2.0 MB"):  # fmt: skip
        assert part in text
    assert "servers" not in text, "servers that all run are no news"


def test_whether_an_operator_drives_and_why_not(bus: Bus) -> None:
    say(bus, "motion", "active", engaged=False, why_not="the leader is too far\x1b[2J", mode="walk")
    seen = ProgressReader(bus, NAMES).poll()
    assert "operator  not engaged (walk): the leader is too far" in shown(seen)
    assert "\x1b" not in shown(seen)
    say(bus, "motion", "active", engaged=True, why_not="", mode="")
    assert "operator  engaged" in shown(ProgressReader(bus, NAMES).poll())


def test_a_plain_line_says_it_in_words(bus: Bus) -> None:
    play(bus, tilt_rad=1.2)
    line = progress_panel.line(ProgressReader(bus, NAMES).poll())
    assert line == "tour: bow, 7.5 of 20.0 s; fallen, leans 69°, base at 0.75 m; 12 345 messages"


def test_a_blend_is_called_by_its_phase(bus: Bus) -> None:
    play(bus, phase="entering")
    seen = ProgressReader(bus, NAMES).poll()
    assert seen.motion is not None
    assert progress_panel.doing(seen.motion) == "tour: entering"


def test_while_servers_come_up_their_states_are_shown(bus: Bus) -> None:
    say(bus, "g1", "unconfigured")
    say(bus, "motion", "inactive")
    seen = ProgressReader(bus, NAMES).poll()
    assert (seen.motion, seen.robot, seen.policy, seen.recorder) == (None, None, None, None)
    assert progress_panel.line(seen) == ""
    text = shown(seen, step="start g1")
    assert "start g1" in text
    assert "g1 loading   recorder starting   motion ready" in text


def test_a_server_that_died_is_not_said_to_be_starting(bus: Bus) -> None:
    say(bus, "g1", "active")
    text = shown(ProgressReader(bus, NAMES).poll(), died={"motion": "was killed by SIGKILL"})
    assert "g1 running   recorder starting   motion died" in text
    assert "died: was killed by SIGKILL" in text


def test_what_is_on_the_bus_of_others_is_not_shown(bus: Bus) -> None:
    play(bus)
    assert ProgressReader(bus, ["other"]).poll().motion is None


def test_values_that_fit_no_contract_are_passed_over(bus: Bus) -> None:
    play(bus)
    bus.publish({keys.sim_qpos(ROBOT): b"short", keys.policy_timing(ROBOT): b"{}", keys.command_source(ROBOT): b"[",
                 keys.RECORDER: b"no json"})  # fmt: skip
    seen = ProgressReader(bus, NAMES).poll()
    assert seen.robot is None
    assert seen.recorder is None
    assert seen.policy is not None
    assert seen.policy.inference_s is None
    assert seen.motion is not None
    assert seen.motion.phase == ""


def test_an_arm_shows_its_gate_its_profile_and_its_rates_and_why_it_is_faulted(bus: Bus) -> None:
    arm = {"gate": "tracking", "gate_reason": "caught up", "backend": "sim", "profile": "speed125", "sync_hz": 250.0,
           "send_hz": 124.6}  # fmt: skip
    bus.publish({keys.server_config("g1"): codec.json_object({"robot": KR810_ROBOT})})
    say(bus, "g1", "active", **arm)
    progress = ProgressReader(bus, NAMES).poll()
    assert progress.policy is None
    assert "tracking   sim, speed125   250 heartbeats/s   125 targets/s" in shown(progress)
    say(bus, "g1", "active", **arm | {"gate": "faulted", "gate_reason": "safety 1010: torque deviation"})
    assert "faulted: safety 1010: torque deviation" in shown(ProgressReader(bus, NAMES).poll())
