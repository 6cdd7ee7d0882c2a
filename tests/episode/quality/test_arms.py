"""What a check says of an arm's session: heartbeats, targets sent in motion and at hold, faults."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from station.bus import codec, keys
from station.episode.quality.check import check
from station.episode.quality.findings import Quality
from station.episode.reading.reader import open_episode
from tests.episode.arm_run import ROBOT, ArmRun
from tests.episode.synthetic import MONO_START_NS, EpisodeBuilder


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


@pytest.mark.parametrize("lag_s", [0.0, 0.1, 0.4])
def test_the_lag_of_its_joints_is_found_though_every_second_step_sees_the_same_state(
    tmp_path: Path, lag_s: float
) -> None:
    (found,) = swung(tmp_path, seconds=10.0, lag_s=lag_s).alignment
    assert found.lag_s == pytest.approx(lag_s, abs=0.002)
    assert found.lag_correlation == pytest.approx(1.0, abs=0.01)
    assert found.lead_p50_s == pytest.approx(0.002)


def test_an_arm_whose_joints_lag_far_behind_is_misaligned(tmp_path: Path) -> None:
    assert "misaligned" in rules(swung(tmp_path, seconds=10.0, lag_s=0.4))


def test_of_an_arm_that_hardly_moves_no_lag_is_told(tmp_path: Path) -> None:
    (found,) = swung(tmp_path, seconds=1.0, lag_s=0.1).alignment
    assert (found.lag_s, found.lag_correlation) == (None, None)


def swung(folder: Path, *, seconds: float, lag_s: float) -> Quality:
    """Two joints that are swung to and fro, at 250 Hz, and follow after a time; their states are written at 125 Hz."""
    builder = EpisodeBuilder(folder, task="jog")

    def joints(at_s: float) -> list[float]:
        return [0.3 * np.sin(3.0 * at_s), 0.2 * np.sin(7.0 * at_s), *[0.0] * 5]

    for number in range(1, round(seconds * 250)):
        at_s = 0.1 + number * 0.004
        if number % 2:
            builder.write({keys.state_joints(ROBOT): codec.f64([*joints(at_s - lag_s), *[0.0] * 14])}, at_s=at_s)
        read_ns = MONO_START_NS + round(at_s * 1e9)
        timing = [number, number, read_ns - 2_000_000, read_ns - 1_000_000, read_ns, read_ns, read_ns, read_ns]
        values = {
            keys.target(ROBOT): codec.f64(joints(at_s)),
            keys.command_used(ROBOT): codec.f64(joints(at_s)),
            keys.command_gate(ROBOT): codec.json_object({"state": "tracking"}),
            keys.policy_timing(ROBOT): codec.json_vector(timing),
        }
        builder.write(values, at_s=at_s + 0.0002)
    return check(open_episode(builder.finish()))


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


def test_what_a_server_counts_goes_on_when_it_is_started_again_and_that_alone_is_no_fault(tmp_path: Path) -> None:
    made = run(tmp_path)
    made.faults = 3
    made.move(1.0)
    before, made.faults, made.sends = made.sends, 0, 0
    made.move(2.0)
    (arm,) = checked(made).arms
    assert arm.faults == 0, "the three are from before the episode"
    assert arm.sends == (before - 1) + (made.sends - 1), "each of which was told with the next heartbeat"
    assert arm.sync_hz == pytest.approx(250.0, rel=0.01)


def test_faults_of_all_sessions_are_counted_and_the_greatest_of_their_latencies_is_told(tmp_path: Path) -> None:
    made = run(tmp_path)
    made.move(0.5)
    made.faults, made.latency_s = 2, 7e-6
    made.move(0.5)
    made.faults, made.sends, made.latency_s = 1, 0, 3e-6
    made.move(0.5)
    quality = checked(made)
    assert (quality.arms[0].faults, quality.arms[0].sync_to_send_p99_s) == (3, 7e-6)
    assert "arm-fault" in rules(quality)


def test_another_process_counts_from_zero_though_it_soon_has_counted_more(tmp_path: Path) -> None:
    made = run(tmp_path)
    made.move(0.1)
    before, made.writer = made.sends, "kassow-again"
    made.faults = 1
    made.move(0.1)
    (arm,) = checked(made).arms
    assert (arm.faults, arm.sends) == (1, (before - 1) + (made.sends - 1))


def test_counters_that_are_no_numbers_are_passed_over(tmp_path: Path) -> None:
    made = run(tmp_path)
    made.move(0.5)
    for count in (np.nan, np.inf, -1.0, 1e300):
        made.builder.write({keys.state_counters(ROBOT): codec.f64([count] * 19)}, at_s=made.at_s, writer="kassow")
    made.move(0.5)
    (arm,) = checked(made).arms
    assert (arm.faults, arm.sends) == (0, made.sends - 1)
