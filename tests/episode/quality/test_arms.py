"""What a check says of an arm's session: heartbeats, targets sent in motion and at hold, faults."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from station.episode.quality.check import check
from station.episode.quality.findings import Quality
from station.episode.reading.reader import open_episode
from tests.episode.arm_run import ROBOT, ArmRun
from tests.episode.synthetic import EpisodeBuilder


def run(folder: Path, **options: Any) -> ArmRun:
    return ArmRun(EpisodeBuilder(folder, task="jog"), **options)


def checked(made: ArmRun) -> Quality:
    return check(open_episode(made.finish()))


def rules(quality: Quality) -> set[str]:
    return {reason.rule for reason in quality.reasons}


def test_a_run_without_a_fault_has_its_rates_and_is_good(tmp_path: Path) -> None:
    made = run(tmp_path)
    made.hold(1.0)
    made.move(3.0)
    made.hold(2.0)
    quality = checked(made)
    (arm,) = quality.arms
    assert (arm.robot, arm.backend, arm.profiles) == (ROBOT, "sim", ["speed125"])
    assert arm.sync_hz == pytest.approx(250.0, rel=0.002)
    assert arm.sends_moving_hz == pytest.approx(125.0, rel=0.01)
    assert arm.sends_holding_hz == 0.0
    assert arm.moving_s == pytest.approx(3.0, abs=0.45)
    assert arm.holding_s == pytest.approx(2.2, abs=0.6)
    assert arm.sends == made.sends
    assert arm.faults == 0
    assert arm.sync_to_send_p99_s == 3e-6
    assert quality.verdict == "good", quality.reasons


def test_steps_motion_and_tracking_are_measured_as_of_any_robot(tmp_path: Path) -> None:
    made = run(tmp_path)
    made.move(3.0)
    quality = checked(made)
    (steps,), (motion,) = quality.steps, quality.motion
    assert steps.robot == motion.robot == ROBOT
    assert steps.gate_shares["tracking"] > 0.98
    assert steps.mean_joint_error_rad is not None
    assert steps.mean_joint_error_rad < 0.002
    assert motion.jerk_p99_rad_s3 is not None


def test_heartbeats_that_are_missed_are_told(tmp_path: Path) -> None:
    made = run(tmp_path, beats=0.95)
    made.move(3.0)
    assert "arm-sync" in rules(checked(made))


def test_targets_that_are_sent_though_they_stand_are_told(tmp_path: Path) -> None:
    made = run(tmp_path, floods=True)
    made.hold(3.0)
    quality = checked(made)
    assert quality.arms[0].sends_holding_hz == pytest.approx(125.0, rel=0.02)
    assert "arm-flood" in rules(quality)


def test_a_fault_of_the_controller_rejects(tmp_path: Path) -> None:
    made = run(tmp_path)
    made.move(1.0)
    made.faults = 1
    made.hold(1.0)
    quality = checked(made)
    assert quality.verdict == "reject"
    assert "arm-fault" in rules(quality)


def test_a_server_that_was_started_again_counts_from_zero_and_that_is_no_fault(tmp_path: Path) -> None:
    made = run(tmp_path)
    made.faults = 3
    made.move(1.0)
    made.faults, made.sends = 0, 0
    made.move(2.0)
    (arm,) = checked(made).arms
    assert arm.faults == 0
    assert arm.sends == made.sends - 1
    assert arm.sync_hz == pytest.approx(250.0, rel=0.01)
