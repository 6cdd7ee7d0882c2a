"""The arm of `docs/your-arm.md`, as it stands there: a gamepad drives it by the station's own driver and policy."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest

from station import Station
from station.bus.address import parse
from tests.main_job.page_package import install
from tests.main_job.station_runs import Terminal
from tests.waiting import bus_answers, wait_until

JOINTS = ("base", "shoulder", "elbow", "forearm", "wrist", "flange")

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def driven(processes: None, tmp_path_factory: pytest.TempPathFactory) -> Terminal:
    """A terminal in which the package is installed, and whose arm was driven once, however long that took."""
    folder = tmp_path_factory.mktemp("arm")
    terminal = install("your-arm.md", "arm-lab", folder)
    script = folder / "script.json"
    held = {"left_bumper": 1}
    steps = [
        {"at_s": 1.0, "set": held},
        {"at_s": 1.5, "set": held | {"left_stick_y": 1}},
        {"at_s": 4.0, "set": held | {"left_stick_y": 0}},
        {"at_s": 4.5, "set": {"left_bumper": 0}},
    ]
    script.write_text(json.dumps({"device": "gamepad", "period_s": 6.0, "steps": steps}))
    runbook, bus = folder / "arm-lab" / "arm6.yaml", parse(f"unix://{folder}/station/station/bus.sock")
    pad = ("--set", f"gamepad.fake={script}")
    with terminal.start("up", str(runbook), "--yes", "--record", "--task", "wave", *pad) as up:
        try:
            wait_until(lambda: bus_answers(bus))
            with Station(bus.url) as lab:
                wait_until(lambda: base_of(lab) > 0.3)
        finally:
            up.send_signal(signal.SIGINT)
            said, _ = up.communicate(timeout=60)
            Path(folder / "up.log").write_text(said)
        assert up.returncode == 0, said
    return terminal


def base_of(lab: Station) -> float:
    """Where the arm's first joint is [rad]."""
    state = lab.read("robot_state_arm6")
    return float(state.named()["base_pos"]) if state is not None else 0.0


def episode(terminal: Terminal) -> str:
    return str(terminal.episode("wave"))


def test_its_episode_is_good_and_has_joints_with_names(driven: Terminal, tmp_path: Path) -> None:
    found = driven.json("check", episode(driven))
    assert (found["verdict"], found["falls"]) == ("good", 0), found["reasons"]
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
    assert audit["observations"]["compared"] == audit["steps"] > 100
    assert (audit["different"], audit["observations"]["different"]) == (0, 0)
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
