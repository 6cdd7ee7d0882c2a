"""The arm of `docs/your-arm.md`, as it stands there: a gamepad drives it by the station's own driver and policy."""

from __future__ import annotations

import contextlib
import json
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from station import Station
from station.bus.address import parse
from station.episode.reading.reader import open_episode
from tests.main_job.page_package import install
from tests.main_job.station_runs import Terminal, begins_with_a_state
from tests.verdicts import OF_LATENESS
from tests.waiting import bus_answers, wait_until

WRIST = "action_joints_arm6_wrist"
JOINTS = ("base", "shoulder", "elbow", "forearm", "wrist", "flange")

pytestmark = pytest.mark.timeout(300)


HELD = {"left_bumper": 1}
PAD = [
    {"at_s": 1.0, "set": HELD},
    {"at_s": 1.5, "set": HELD | {"left_stick_y": 1}},
    {"at_s": 4.0, "set": HELD | {"left_stick_y": 0}},
    {"at_s": 4.5, "set": {"left_bumper": 0}},
]
KEYS = [
    {"at_s": 1.0, "press": "enter"},
    {"at_s": 2.0, "press": "up", "for_s": 1.0},
    {"at_s": 5.0, "plugged": False},
    {"at_s": 9.0, "plugged": True},
]


@pytest.fixture(scope="module")
def place(processes: None, tmp_path_factory: pytest.TempPathFactory) -> tuple[Terminal, Path]:
    """A terminal in which the package is installed, and the folder that holds everything."""
    folder = tmp_path_factory.mktemp("arm")
    return install("your-arm.md", "arm-lab", folder), folder


@contextlib.contextmanager
def running(
    place: tuple[Terminal, Path], runbook: str, task: str, *settings: str, **scripts: object
) -> Iterator[Station]:
    """A runbook of the page, recorded, with scripts of fake devices that begin again; ended as by Ctrl-C."""
    terminal, folder = place
    fakes = [word for setting in settings for word in ("--set", setting)]
    for device, steps in scripts.items():
        script = folder / f"{device}.json"
        script.write_text(json.dumps({"device": device, "period_s": 12.0, "steps": steps}))
        fakes += ["--set", f"{device}.fake={script}"]
    bus = parse(f"unix://{folder}/station/station/bus.sock")
    command = ("up", str(folder / "arm-lab" / runbook), "--yes", "--record", "--task", task, *fakes)
    with terminal.start(*command) as up:
        try:
            wait_until(lambda: up.poll() is not None or bus_answers(bus))
            with Station(bus.url) as lab:
                yield lab
        finally:
            up.send_signal(signal.SIGINT)
            said, _ = up.communicate(timeout=60)
            sys.stdout.write(said)  # shown where it failed
        assert up.returncode == 0


@pytest.fixture(scope="module")
def driven(place: tuple[Terminal, Path]) -> Terminal:
    """The terminal, where the arm was driven once, however long that took."""
    with running(place, "arm6.yaml", "wave", gamepad=PAD) as lab:
        wait_until(lambda: base_of(lab) > 0.3)
    return place[0]


@pytest.fixture(scope="module")
def driven_apart(place: tuple[Terminal, Path], driven: Terminal) -> Terminal:
    """The terminal, where two operators drove arm and wrist, and the keyboard of one was torn out."""
    soon = "wrist_operator.patience_s=1"  # then its commands end
    with running(place, "arm6-parts.yaml", "both", soon, gamepad=PAD, keyboard=KEYS) as lab:
        wait_until(lambda: states(lab) == ("tracking", "tracking"))
        wait_until(lambda: refused_beside(lab))
        wait_until(lambda: states(lab) == ("tracking", "waiting"))
        before = base_of(lab)
        wait_until(lambda: base_of(lab) > before + 0.1)
    return driven


def refused_beside(lab: Station) -> bool:
    """Write the wrist's command beside its operator; return whether that was refused yet."""
    lab.publish({WRIST: [0.0, 0.0, 0.0]})
    gate = lab.read("command_gate_arm6")
    return gate is not None and gate.json()["parts"]["wrist"]["refused"] > 0


def states(lab: Station) -> tuple[str, ...]:
    """What the gates of upper arm and wrist do."""
    gate = lab.read("command_gate_arm6")
    return tuple(part["state"] for part in gate.json()["parts"].values()) if gate is not None else ()


def base_of(lab: Station) -> float:
    """Where the arm's first joint is [rad]."""
    state = lab.read("robot_state_arm6")
    return float(state.named()["base_pos"]) if state is not None else 0.0


def episode(terminal: Terminal, task: str = "wave") -> str:
    return str(terminal.episode(task))


def expect_derived(audit: dict[str, Any]) -> None:
    """Expect every step to follow from what is recorded; a recording may begin between a state and the step from it."""
    assert audit["steps"] > 100
    has_first = begins_with_a_state(audit)
    assert audit["segments"] == (1 if has_first else 2)
    assert (audit["different"], audit["observations"]["different"]) == (0, 0)
    assert audit["observations"]["compared"] == audit["steps"] - (not has_first), audit["not_derived"]


def test_its_episode_is_good_and_has_joints_with_names(driven: Terminal, tmp_path: Path) -> None:
    found = driven.json("check", episode(driven))
    assert {reason["rule"] for reason in found["reasons"]} <= OF_LATENESS, found["reasons"]
    assert found["falls"] == 0
    (robot,) = found["steps"]
    assert (robot["robot"], robot["missing_steps"]) == ("arm6", 0)
    assert robot["mean_joint_error_rad"] < 0.1
    done = driven.run("export", "lerobot", episode(driven), "--out", str(tmp_path / "set"))
    assert done.returncode == 0, done.stdout + done.stderr
    features = json.loads((tmp_path / "set" / "meta" / "info.json").read_text())["features"]
    assert features["action"]["names"] == [f"{joint}_pos" for joint in JOINTS]
    assert features["observation.state"]["names"][:6] == [f"{joint}_pos" for joint in JOINTS]


def test_what_it_did_is_derived_again_and_simulated_again_bit_for_bit(driven: Terminal) -> None:
    audit = driven.json("audit", episode(driven))
    assert audit["policy"] == "direct"
    expect_derived(audit)
    assert driven.json("replay", episode(driven), "--to", "sim")["different"] == 0


def test_its_curves_and_pictures_are_drawn(driven: Terminal, tmp_path: Path) -> None:
    plot, drawn = tmp_path / "plot.png", tmp_path / "ep.rrd"
    assert driven.run("view", episode(driven), "--plot", str(plot), "--save", str(drawn)).returncode == 0
    assert plot.stat().st_size > 50_000
    assert drawn.stat().st_size > 50_000


def test_its_gains_and_limits_are_told(driven: Terminal) -> None:
    (facts,) = [each for each in driven.json("episodes", "show", episode(driven))["manifest"]["servers"].values()
                if each.get("robot") == "arm6" and each["role"] == "low-level"]  # fmt: skip
    assert facts["policy"]["kp"] == [300.0, 300.0, 200.0, 60.0, 60.0, 30.0]
    assert [joint["name"] for joint in facts["description"]["joints"]] == list(JOINTS)


def test_where_one_operator_s_keyboard_is_torn_out_the_other_drives_on(driven_apart: Terminal) -> None:
    shown = driven_apart.json("episodes", "show", episode(driven_apart, "both"))["manifest"]["events"]
    assert {event["numbers"]["part"] for event in shown if event["name"] == "gate"} == {"upper", "wrist"}
    rivals = [event["numbers"] for event in shown if event["name"] == "second-writer"]
    assert {rival["key"] for rival in rivals} == {WRIST}
    ends = [event for event in shown if event["name"] == "teleop-commands-end"]
    assert "wrist_operator" in [end["source"] for end in ends if "has been away" in end["numbers"]["reason"]]


def test_what_both_did_is_derived_again_and_each_part_has_its_names(driven_apart: Terminal) -> None:
    audit = driven_apart.json("audit", episode(driven_apart, "both"))
    expect_derived(audit)
    found = driven_apart.json("check", episode(driven_apart, "both"))
    (robot,) = found["steps"]
    assert (robot["robot"], robot["missing_steps"]) == ("arm6", 0)
    assert sum(stream["lost"] for stream in found["streams"]) == 0
    contract = open_episode(episode(driven_apart, "both")).contract("command_used_arm6_wrist")
    assert contract is not None
    assert contract.names == ("forearm_pos", "wrist_pos", "flange_pos")
    refused = driven_apart.run("replay", episode(driven_apart, "both"), "--to", "sim")
    assert refused.returncode == 1
    assert "the parts of arm6 were commanded apart, and are not simulated again" in refused.stderr
