"""The robot of `docs/your-robot.md`, as it stands there: driven, recorded, checked, audited, drawn and exported."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.main_job.page_package import install
from tests.main_job.station_runs import LOCK_STEP, Terminal
from tests.verdicts import OF_A_LATE_MACHINE

JOINTS = [f"{leg}_{joint}" for leg in ("front_left", "front_right", "rear_left", "rear_right")
          for joint in ("roll", "hip", "knee")]  # fmt: skip
SETTINGS = [setting.replace("g1.", "robot.") for setting in LOCK_STEP]

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def trotted(processes: None, tmp_path_factory: pytest.TempPathFactory) -> Terminal:
    """A terminal in which the package is installed, and its robot has walked once, recorded."""
    folder = tmp_path_factory.mktemp("quad")
    terminal = install("your-robot.md", "quad-lab", folder)
    runbook = folder / "quad-lab" / "quad.yaml"
    sets = [word for setting in SETTINGS for word in ("--set", setting)]
    done = terminal.run("up", str(runbook), "--yes", "--record", "--task", "trot", *sets)
    assert done.returncode == 0, done.stdout + done.stderr
    return terminal


def episode(terminal: Terminal) -> str:
    return str(terminal.episode("trot"))


def test_its_episode_is_good_and_was_recorded_step_by_step(trotted: Terminal) -> None:
    found = trotted.json("check", episode(trotted))
    assert {reason["rule"] for reason in found["reasons"]} <= OF_A_LATE_MACHINE, found["reasons"]
    assert found["falls"] == 0
    (robot,) = found["steps"]
    assert (robot["robot"], robot["missing_steps"]) == ("quad", 0)
    assert robot["steps"] > 100
    assert robot["mean_joint_error_rad"] is None, "no joint is commanded"
    assert 0.0 < max(robot["velocity"]["error"]) < 0.5, "a velocity is, and its place is known"
    walked = trotted.run("check", episode(trotted))
    assert "nan" not in walked.stdout
    assert walked.stderr == ""


def test_its_policy_is_derived_again_bit_for_bit_and_its_simulation_too(trotted: Terminal) -> None:
    audit = trotted.json("audit", episode(trotted))
    assert audit["policy"] == "quad-trot"
    assert audit["observations"]["compared"] == audit["steps"] > 100
    assert (audit["different"], audit["observations"]["different"]) == (0, 0)
    replay = trotted.json("replay", episode(trotted), "--to", "sim")
    assert (replay["different"], replay["fell"]) == (0, False)


def test_its_curves_and_pictures_are_drawn(trotted: Terminal, tmp_path: Path) -> None:
    plot = tmp_path / "plot.png"
    assert trotted.run("view", episode(trotted), "--plot", str(plot)).returncode == 0
    assert plot.stat().st_size > 50_000
    drawn = tmp_path / "ep.rrd"
    assert trotted.run("view", episode(trotted), "--save", str(drawn)).returncode == 0
    assert drawn.stat().st_size > 50_000


def test_its_columns_have_names_in_training_data(trotted: Terminal, tmp_path: Path) -> None:
    done = trotted.run("export", "lerobot", episode(trotted), "--out", str(tmp_path / "set"))
    assert done.returncode == 0, done.stdout + done.stderr
    features = json.loads((tmp_path / "set" / "meta" / "info.json").read_text())["features"]
    assert features["action"]["names"] == ["vx", "vy", "wz"]
    assert features["observation.state"]["names"][:12] == [f"{joint}_pos" for joint in JOINTS]


def test_it_is_rehearsed_by_its_name(trotted: Terminal) -> None:
    (found,) = trotted.json("rehearse", "builtin:walk-forward", "--robot", "quad-mujoco")["motions"]
    assert (found["fell"], found["mean_joint_error_rad"]) == (False, None)
