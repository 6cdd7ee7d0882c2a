"""A policy of others that follows velocities walks the G1 by a script: through the real processes, in lock-step."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.main_job.station_runs import LOCK_STEP, Terminal
from tests.main_job.velocity_runs import FIGURES_WITHIN, HOLOSOMA, RUNBOOK, Walked, expect_figures, expect_sound, walk
from tests.verdicts import OF_A_LATE_MACHINE

SCRIPT = """
velocities:
  - {seconds: 4, vx: 0.5}
  - {seconds: 4, wz: 1.4}
"""
SETTINGS = [setting.replace("g1.", "robot.") for setting in LOCK_STEP]

pytestmark = [pytest.mark.assets, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def walked(processes: None, assets: Path, tmp_path_factory: pytest.TempPathFactory) -> Walked:
    folder = tmp_path_factory.mktemp("walk")
    script = folder / "patrol.velocity"
    script.write_text(SCRIPT)
    return walk(folder / "station", str(script), *SETTINGS)


def test_it_walks_as_fast_as_in_a_loop_that_is_not_ours(walked: Walked) -> None:
    expect_sound(walked)
    expect_figures(walked, {(0.5, 0.0, 0.0): (0.42, -0.02, 0.02)})


def test_its_episode_is_good_and_tells_how_velocities_were_followed(walked: Walked) -> None:
    assert {reason["rule"] for reason in walked.check["reasons"]} <= OF_A_LATE_MACHINE, walked.check["reasons"]
    assert walked.steps["mean_joint_error_rad"] is None, "no joint is commanded"
    printed = walked.terminal.run("check", walked.episode).stdout
    assert "mean velocity error vx 0." in printed
    assert "commanded +0.50  +0.00  +0.00, measured +0.4" in printed


def test_its_report_tells_it_too_and_a_rehearsal_gives_the_same_figures(walked: Walked, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    assert walked.terminal.run("report", walked.episode, "--out", str(page)).returncode == 0
    assert "commanded +0.50  +0.00  +0.00, measured +0.4" in page.read_text(encoding="utf-8")
    (rehearsed,) = walked.terminal.json("rehearse", walked.script, "--policy", "holosoma", "--checkpoint", HOLOSOMA)[
        "motions"
    ]
    within = FIGURES_WITHIN if walked.check["reasons"] else 1e-9  # a bus that is lost breaks the lock-step
    for ours, theirs in zip(walked.steps["velocity"]["stretches"], rehearsed["velocity"]["stretches"], strict=True):
        assert ours["measured"] == pytest.approx(theirs["measured"], abs=within), "a lock-step station is a rehearsal"


def test_more_than_the_policy_was_trained_on_is_clamped_and_told(walked: Walked) -> None:
    assert walked.check["events"]["command-clamped"] == 2, "when it began, and when it had ended"
    assert (0.0, 0.0, 1.0) in walked.measured(), "1.4 rad/s was asked for"
    assert "command-clamped elements=['wz']" in walked.output


def test_it_is_simulated_again_bit_for_bit(walked: Walked) -> None:
    replay = walked.terminal.json("replay", walked.episode, "--to", "sim")
    assert (replay["different"], replay["fell"], replay["gates_different"]) == (0, False, 0)
    assert replay["steps"] == walked.steps["steps"]


def test_whoever_lacks_the_file_is_told_where_it_comes_from(walked: Walked) -> None:
    done = walked.terminal.run("up", RUNBOOK, "--yes", "--set", "robot.policy=holosoma")
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert "name its file with `checkpoint`; it is not part of the station: take it from the PyPI wheel" in line


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["motion.motion=velocity:figure-eigth"], "unknown script of velocities 'figure-eigth' (did you mean"),
        (['motion.robot=""'], "commands 'velocity' are for any robot; name the one that takes them"),
        (["motion.format=twist2"], "'twist2' are for one robot, and need no name of it"),
    ],
)
def test_what_cannot_be_is_told_in_a_line_before_anything_starts(
    walked: Walked, settings: list[str], words: str
) -> None:
    sets = [word for setting in settings for word in ("--set", setting)]
    terminal: Terminal = walked.terminal
    done = terminal.run("up", RUNBOOK, "--yes", *sets)
    assert done.returncode == 2, done.stdout + done.stderr
    (line,) = done.stderr.strip().splitlines()
    assert words in line


def test_a_policy_that_needs_the_velocity_of_the_base_takes_over_on_the_walk_and_is_audited(
    tmp_path: Path, processes: None, assets: Path
) -> None:
    terminal, sets = Terminal(tmp_path), []
    for setting in (
        *SETTINGS, "robot.policies.joystick.policy=playground-g1",
        "robot.policies.joystick.checkpoint=zoo:policies/playground_g1_policy.onnx", "motion.motion=velocity:forward",
        "motion.loop=true",
    ):  # fmt: skip
        sets += ["--set", setting]
    station = terminal.start("up", RUNBOOK, "--yes", "--record", "--task", "hand-over", *sets)
    try:
        for line in station.stdout or ():
            if "to=tracking" in line:
                break
        done = terminal.run("policy", "switch", "joystick")
        assert done.returncode == 0, done.stdout + done.stderr
        assert terminal.run("down").returncode == 0
    finally:
        station.communicate(timeout=60.0)
    episode = str(terminal.episode("hand-over"))
    audit = terminal.json("audit", episode)
    assert [each["policy"] for each in audit["took_over"]] == ["playground-g1"]
    assert audit["observations"]["compared"] == audit["steps"] > 0
    assert (audit["different"], audit["observations"]["different"], audit["commands"]["different"]) == (0, 0, 0)
    velocities = {stream["key"]: stream["count"] for stream in terminal.json("check", episode)["streams"]}
    assert velocities["root_velocity_g1_29"] == velocities["robot_state_g1_29"], (
        "from the beginning, not from the switch"
    )


@pytest.mark.parametrize(("runbook", "robot"), [("g1-velocity-gamepad", "g1_29"), ("go2-sim-gamepad", "go2")])
def test_a_gamepad_drives_it_by_velocities(runbook: str, robot: str, tmp_path: Path, processes: None) -> None:
    terminal = Terminal(tmp_path)
    pad = ("--set", "gamepad.fake=builtin:gamepad/example.json")
    done = terminal.run("up", runbook, "--yes", "--record", "--task", "pad", "--for", "6s", *pad)
    assert done.returncode == 0, done.stdout + done.stderr
    check = terminal.json("check", str(terminal.episode("pad")))
    assert check["events"]["operator-engaged"] == 1, done.stderr
    assert check["falls"] == 0
    keys = {stream["key"] for stream in check["streams"]}
    assert {f"action_velocity_{robot}", "operator_controls_gamepad"} <= keys
