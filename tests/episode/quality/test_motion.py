"""Idle ends, jerk, joint limits, cameras and alignment: each against a signal whose answer is known."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from adapters.robots.g1.joints import G1_29
from station.bus import keys
from station.episode.quality.check import check
from station.episode.quality.findings import Quality
from station.episode.reading.reader import open_episode
from station.protocols import Floats
from tests.episode.synthetic import STANDING, EpisodeBuilder, command, tick

ELBOW = G1_29.index("left_elbow")
ANKLE = G1_29.index("left_ankle_roll")


@pytest.fixture
def builder(tmp_path: Path) -> EpisodeBuilder:
    return EpisodeBuilder(tmp_path)


def run(
    builder: EpisodeBuilder, seconds: float, elbow: Callable[[float], float], *, lag_s: float = 0.0, joint: int = ELBOW,
    jitter_s: float = 0.0,
) -> Quality:  # fmt: skip
    """A joint that follows a function of time, as asked, and later as measured."""
    noise = np.random.default_rng(7)
    for number in range(round(seconds * 50)):
        at_s = number / 50
        q, asked = STANDING.copy(), STANDING.copy()
        q[joint], asked[joint] = elbow(at_s - lag_s), elbow(at_s)
        tick(builder, number, at_s=0.1 + at_s + jitter_s * noise.random(), q=q, asked=command(q=asked))
    return check(open_episode(builder.finish()))


def test_time_without_motion_is_told_for_either_end(builder: EpisodeBuilder) -> None:
    def wave(at_s: float) -> float:
        return 1.2 + (0.5 * np.sin(6.0 * (at_s - 3.0)) if 3.0 <= at_s <= 5.0 else 0.0)

    (moved,) = run(builder, 9.0, wave).motion
    assert moved.idle_head_s == pytest.approx(3.0, abs=0.6)
    assert moved.idle_tail_s == pytest.approx(4.0, abs=0.6)
    assert (moved.idle_below_rad, moved.idle_window_s) == (0.05, 0.5)


def test_a_robot_that_never_moves_is_idle_from_end_to_end_and_that_has_a_rule(builder: EpisodeBuilder) -> None:
    quality = run(builder, 16.0, lambda _: 1.2)
    (moved,) = quality.motion
    assert (moved.idle_head_s, moved.idle_tail_s) == (pytest.approx(16.0, abs=0.1), 0.0)
    assert "idle-ends" in {reason.rule for reason in quality.reasons}
    assert (moved.jerk_p99_rad_s3, moved.limit_hits) == (pytest.approx(0.0, abs=1e-6), 0)


def test_jerk_is_that_of_the_motion_whatever_the_time_stamps(builder: EpisodeBuilder) -> None:
    def cubic(at_s: float) -> float:  # its third derivative is 60 rad/s^3 throughout
        return 10.0 * (at_s - 0.5) ** 3

    (moved,) = run(builder, 1.0, cubic, jitter_s=0.001).motion
    assert moved.jerk_p99_rad_s3 == pytest.approx(60.0, rel=0.2)
    assert moved.worst_jerk_joint == "left_elbow"


def test_a_quantum_of_an_encoder_is_no_jerk_to_speak_of(builder: EpisodeBuilder) -> None:
    (moved,) = run(builder, 2.0, lambda at_s: round(np.sin(at_s) * 1e4) / 1e4).motion
    assert moved.jerk_p99_rad_s3 is not None
    assert moved.jerk_p99_rad_s3 < 10.0


def test_a_gap_between_states_is_no_jerk(builder: EpisodeBuilder) -> None:
    for number in range(100):
        q = STANDING.copy()
        q[ELBOW] = 1.2 if number < 50 else 1.9
        tick(builder, number, at_s=0.1 + number / 50 + (1.0 if number >= 50 else 0.0), q=q)
    (moved,) = check(open_episode(builder.finish())).motion
    assert moved.jerk_max_rad_s3 == pytest.approx(0.0, abs=1e-6)


def test_a_robot_that_shakes_is_jerky(builder: EpisodeBuilder) -> None:
    quality = run(builder, 2.0, lambda at_s: 1.2 + 0.3 * np.sin(2 * np.pi * 8 * at_s))
    assert "jerky" in {reason.rule for reason in quality.reasons}


def test_a_command_that_jitters_is_told_though_the_robot_smooths_it(builder: EpisodeBuilder) -> None:
    noise = np.random.default_rng(7)
    for number in range(200):
        asked = STANDING.copy()
        asked[ELBOW] += 0.1 * noise.standard_normal()
        tick(builder, number, at_s=0.1 + number / 50, asked=command(q=asked))
    quality = check(open_episode(builder.finish()))
    (reason,) = [reason for reason in quality.reasons if reason.rule.startswith("jerky")]
    assert reason.rule == "jerky-command"
    assert "left_elbow" in reason.text


def test_joints_at_their_ends_are_counted_by_the_limits_of_the_robots_description(
    builder: EpisodeBuilder,
) -> None:
    def pushed(at_s: float) -> float:  # the ankle ends at 0.2618 rad; within 1 mrad of that it is at its end
        return 0.27 if 1.0 <= at_s < 1.5 else 0.2615 if at_s >= 3.0 else 0.26 if at_s >= 2.5 else 0.0

    quality = run(builder, 4.0, pushed, joint=ANKLE)
    (moved,) = quality.motion
    assert moved.limits_from == "description of unitree_g1"
    assert (moved.limit_hits, list(moved.limit_joints)) == (2, ["left_ankle_roll"])
    assert moved.limit_share == pytest.approx(1.5 / 4.0)
    assert moved.beyond_limit_rad == pytest.approx(0.27 - 0.2618)
    assert "joint-limits" in {reason.rule for reason in quality.reasons}


@pytest.mark.parametrize("lag_s", [0.0, 0.06, 0.13, 0.35])
def test_the_lag_of_the_joints_behind_the_command_is_found(builder: EpisodeBuilder, lag_s: float) -> None:
    quality = run(builder, 8.0, lambda at_s: np.sin(4.0 * at_s) + 0.3 * np.sin(9.0 * at_s), lag_s=lag_s)
    (found,) = quality.alignment
    assert found.lag_s == pytest.approx(lag_s, abs=0.005)
    assert found.lag_correlation == pytest.approx(1.0, abs=0.02)
    assert found.lead_p50_s == pytest.approx(0.004)
    assert (found.repeated, found.skipped) == (0, 0)


def test_a_state_that_moves_before_its_command_is_misaligned(builder: EpisodeBuilder) -> None:
    quality = run(builder, 8.0, lambda at_s: np.sin(4.0 * at_s), lag_s=-0.1)
    (reason,) = [reason for reason in quality.reasons if reason.rule == "misaligned"]
    assert "100 ms before the command" in reason.text


def test_a_command_that_is_used_again_is_told(builder: EpisodeBuilder) -> None:
    for number in range(100):
        tick(builder, number, at_s=0.1 + number / 50, command_seq=number // 2 + 1)
    (found,) = check(open_episode(builder.finish())).alignment
    assert found.repeated == 50


def test_numbers_that_no_robot_writes_measure_nothing_and_break_nothing(builder: EpisodeBuilder) -> None:
    for number in range(60):
        q: Floats = STANDING.copy()
        q[3], q[4], q[5] = np.nan, 1e308 * (-1) ** number, np.inf
        tick(builder, number, at_s=0.1 + number / 50, q=q, asked=command())
    quality = check(open_episode(builder.finish()))
    assert quality.alignment[0].lag_s is None


def jpeg() -> bytes:
    made = io.BytesIO()
    picture = Image.new("RGB", (32, 24), (200, 40, 40))
    picture.paste((20, 90, 220), (0, 0, 16, 24))
    picture.save(made, format="jpeg")
    return made.getvalue()


def filmed(
    builder: EpisodeBuilder, numbers: list[int], *, spent: int = 0, rate_hz: float = 30.0, stated: object = None
) -> Quality:  # fmt: skip
    """A camera that wrote these of its pictures; of `spent` it spent the number, and lost the write."""
    key, data = keys.camera_image("head"), jpeg()
    for number in numbers:
        builder.write({key: data}, at_s=1.0 + number / rate_hz, writer="camera")
    for _ in range(spent):
        builder.skip(key, writer="camera")
    builder.write({key: data}, at_s=1.0 + (numbers[-1] + 1 + spent) / rate_hz, writer="camera")
    return check(open_episode(builder.finish({"servers": {"head": {"key": key, "fps": stated}}})))


def test_a_camera_that_drops_nothing_is_whole(builder: EpisodeBuilder) -> None:
    (camera,) = filmed(builder, list(range(90))).cameras
    assert (camera.name, camera.frames, camera.expected, camera.missing) == ("head", 91, 91, 0)
    assert camera.rate_hz == pytest.approx(30.0)
    assert camera.longest_gap_s == pytest.approx(1 / 30)


def test_pictures_that_never_got_a_number_are_missed_on_the_cameras_own_beat(builder: EpisodeBuilder) -> None:
    quality = filmed(builder, [number for number in range(90) if not 40 <= number < 64])
    (camera,) = quality.cameras
    assert (camera.missing, camera.lost, camera.expected) == (24, 0, 91)
    assert camera.longest_gap_s == pytest.approx(25 / 30)
    assert {reason.rule: reason.verdict for reason in quality.reasons if reason.rule.startswith("camera")} == {
        "camera-drops": "reject",
        "camera-gap": "usable",
    }


def on_a_grid(builder: EpisodeBuilder, taken_s: list[float]) -> Quality:
    for at_s in taken_s:
        builder.write({keys.camera_image("head"): jpeg()}, at_s=1.0 + at_s, writer="camera")
    return check(open_episode(builder.finish()))


def test_a_camera_whose_times_lie_on_a_simulations_grid_has_its_own_rate_and_no_holes(builder: EpisodeBuilder) -> None:
    quality = on_a_grid(builder, [np.ceil(number * 50 / 30) / 50 for number in range(150)])
    (camera,) = quality.cameras
    assert camera.rate_hz == pytest.approx(30.0, rel=0.01)
    assert (camera.missing, cameras_reasons(quality)) == (0, [])


def test_a_picture_that_is_late_is_not_missing_and_a_beat_that_drifts_is_no_hole(builder: EpisodeBuilder) -> None:
    late = {20: 0.03, 40: 0.025, 41: 0.02}
    taken = [number / 30 * (1.0 + 1e-4 * number) + late.get(number, 0.0) for number in range(300) if number != 100]
    (camera,) = on_a_grid(builder, taken).cameras
    assert camera.missing == 1


def test_pictures_that_were_lost_by_number_are_told_as_that(builder: EpisodeBuilder) -> None:
    (camera,) = filmed(builder, list(range(90)), spent=3).cameras
    assert (camera.missing, camera.lost) == (3, 3)


def test_a_slow_camera_is_told(builder: EpisodeBuilder) -> None:
    quality = filmed(builder, list(range(0, 90, 2)))
    assert "camera-slow" in {reason.rule for reason in quality.reasons}
    assert quality.cameras[0].nominal_hz == 30.0


def cameras_reasons(quality: Quality) -> list[str]:
    return [reason.rule for reason in quality.reasons if reason.rule.startswith("camera")]


@pytest.mark.parametrize("rate_hz", [15.0, 2.0])
def test_a_camera_that_was_set_to_few_pictures_is_judged_by_that(builder: EpisodeBuilder, rate_hz: float) -> None:
    quality = filmed(builder, list(range(40)), rate_hz=rate_hz, stated=rate_hz)
    assert quality.cameras[0].nominal_hz == rate_hz
    assert cameras_reasons(quality) == []


def test_a_camera_that_gives_less_than_it_was_set_to_is_told_whatever_is_usual(builder: EpisodeBuilder) -> None:
    assert cameras_reasons(filmed(builder, list(range(90)), rate_hz=30.0, stated=60)) == ["camera-slow"]


@pytest.mark.parametrize("stated", ["fast", -1.0, float("nan"), {}], ids=str)
def test_a_rate_that_is_none_leaves_the_contracts(builder: EpisodeBuilder, stated: object) -> None:
    assert filmed(builder, list(range(9)), stated=stated).cameras[0].nominal_hz == 30.0
