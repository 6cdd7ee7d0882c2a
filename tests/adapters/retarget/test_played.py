"""A person's motion in a file, and as a motion of the robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.motions.load import load
from adapters.retarget import evaluate, skeleton_file
from adapters.retarget.calibration import calibrate, from_height
from adapters.retarget.human import standing
from adapters.retarget.played import RetargetedMotion, noisy, person_of
from adapters.retarget.skeleton_file import Skeletons
from station import rotations
from station.control.rig import RigConfig, build
from station.errors import BadFile, UsageError
from station.operator.sample import Body
from station.rehearse import rehearse
from tests.adapters.retarget.people import ADULT, doing
from tests.examples import some


def test_a_file_gives_back_what_was_written(tmp_path: Path) -> None:
    path, person = tmp_path / "wave.npz", doing("wave")
    skeleton_file.save(path, person)
    found = skeleton_file.load(path)
    for name in ("positions", "quats_wxyz", "times_s"):
        np.testing.assert_array_equal(getattr(found, name), getattr(person, name))
    assert found.height_m == person.height_m
    skeleton_file.save(path, replace(person, height_m=None))
    assert skeleton_file.load(path).height_m is None


def _written(path: Path, **changes: Any) -> Path:
    person = doing("wave")
    members = {"positions": person.positions, "quats_wxyz": person.quats_wxyz, "times_s": person.times_s} | changes
    np.savez(path, **{name: value for name, value in members.items() if value is not None})
    return path


def _with(name: str, at: Any, value: float) -> dict[str, np.ndarray]:
    array = getattr(doing("wave"), name).copy()
    array[at] = value
    return {name: array}


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"times_s": None}, "has no member 'times_s'"),
        ({"positions": np.zeros((5, 23, 3))}, r"positions is float64 of shape \(5, 23, 3\)"),
        ({"positions": np.array(["a"])}, "positions is <U1"),
        ({"times_s": np.arange(5.0)}, "frames per member"),
        (_with("times_s", 7, 0.0), "times_s does not rise at frame 7"),
        (_with("positions", (9, 3, 1), np.nan), "positions is not finite in frame 9"),
        (_with("quats_wxyz", (9, 3), 0.0), "spine1 of frame 9: quaternion of length 0.00"),
        ({"height_m": np.float64(17.0)}, "height_m is 17"),
    ],
)
def test_a_file_that_is_none_is_told_in_one_line(tmp_path: Path, changes: dict[str, Any], told: str) -> None:
    path = _written(tmp_path / "bad.npz", **changes)
    with pytest.raises(BadFile, match=told) as caught:
        skeleton_file.load(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 torn", b"no archive at all"])
def test_a_torn_file_is_told_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "torn.npz"
    path.write_bytes(content)
    with pytest.raises(BadFile) as caught:
        skeleton_file.load(path)
    assert "\n" not in str(caught.value)


def test_objects_in_a_file_are_not_unpickled(tmp_path: Path) -> None:
    path = _written(tmp_path / "bad.npz", positions=np.array([{"a": 1}], dtype=object))
    with pytest.raises(BadFile, match="not a readable skeleton file"):
        skeleton_file.load(path)


def test_a_stream_is_seen_as_it_comes_without_a_frame_that_has_not_come() -> None:
    person = doing("wave")
    played = RetargetedMotion(person)
    assert played.duration_s == pytest.approx(person.times_s[-1])
    assert played.fps == pytest.approx(90.0)
    assert played.at(person.times_s[20] - 1e-4) is played.references[19]
    assert played.at(float(person.times_s[20])) is played.references[20]
    assert played.at(-1.0) is played.references[0]
    assert played.at(1e9) is played.references[-1]
    assert played.facts()["person_m"] == pytest.approx(1.72, abs=0.01)


def test_a_reference_may_ask_for_what_a_person_makes_of_a_motion() -> None:
    clip, played = load("builtin:stand"), load("builtin:stand#retarget=1.6")
    assert played.name == "builtin:stand#retarget=1.6"
    assert played.facts()["person_m"] == pytest.approx(1.6, abs=0.01)
    assert played.facts()["sha256"] == clip.facts()["sha256"]
    assert played.duration_s == pytest.approx(clip.duration_s, abs=0.02)
    np.testing.assert_allclose(played.at(2.0).q, clip.at(2.0).q, atol=0.02)
    with pytest.raises(UsageError, match=r"retarget is 'tall'; expected a number, for example 1\.75"):
        load("builtin:stand#retarget=tall")


def test_who_is_how_tall_must_be_known() -> None:
    person = replace(doing("wave"), height_m=None)
    with pytest.raises(UsageError, match="how tall the person is"):
        RetargetedMotion(person)
    assert RetargetedMotion(replace(person, times_s=person.times_s), calibration=from_height(1.72)).name == "skeleton"
    with pytest.raises(UsageError, match="a person of 17 m"):
        person_of(load("builtin:wave"), 17)


@pytest.mark.parametrize("clip", some(["walk-forward", "squat"]))
def test_the_tracker_follows_what_a_person_does_as_it_follows_the_clip(clip: str) -> None:
    """Real policy, real physics, a tracker with noise: no fall, and hardly more error than of the clip itself."""
    rig = build(RigConfig(robot_options={"physics_dt_s": 0.002}))
    person = noisy(doing(clip), metres=0.001, radians=0.005)
    clips = (load(f"builtin:{clip}"), RetargetedMotion(_first_seconds(person, 6.0)))
    of_clip, of_person = (
        rehearse(motion, rig.policy, rig.robot, rig.command_format, period_s=rig.period_s) for motion in clips
    )
    assert not of_clip.fell
    assert not of_person.fell
    assert of_person.mean_joint_error_rad is not None
    assert of_clip.mean_joint_error_rad is not None
    assert of_person.mean_joint_error_rad < 1.3 * of_clip.mean_joint_error_rad


def test_the_tracker_walks_on_under_a_bad_device_and_a_careless_calibration() -> None:
    """72 Hz with a third of the samples lost, drift, frames of unknown zero, and an operator measured 4° off."""
    random, clip = np.random.default_rng(0), load("builtin:walk-forward")
    unknown = rotations.normalized(random.normal(size=(24, 4)))
    careless = rotations.from_rotation_vector(random.normal(scale=0.07, size=(24, 3)))
    still = standing(ADULT)
    seen = Body(still.positions, rotations.multiply(rotations.multiply(careless, still.quats_wxyz), unknown))
    person = noisy(person_of(clip, 1.72, rate_hz=72.0), metres=0.002, radians=0.008)
    drift = np.cumsum(random.normal(scale=0.0005, size=(len(person), 1, 3)), axis=0)
    came = random.random(len(person)) > 0.33
    tracked = replace(
        person,
        positions=(person.positions + drift)[came],
        quats_wxyz=rotations.multiply(person.quats_wxyz, unknown[None])[came],
        times_s=person.times_s[came],
    )
    rig = build(RigConfig(robot_options={"physics_dt_s": 0.002}))
    played = RetargetedMotion(tracked, calibration=calibrate([seen] * 30, "Ada"))
    result = rehearse(played, rig.policy, rig.robot, rig.command_format, period_s=rig.period_s)
    assert not result.fell
    assert result.mean_joint_error_rad is not None
    assert result.mean_joint_error_rad < 0.1


def test_the_evaluation_prints_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate.main(["builtin:stand", "--height", "1.6"]) == 0
    assert "builtin:stand" in capsys.readouterr().out


def test_the_evaluation_tells_in_one_line_what_it_cannot_do(capsys: pytest.CaptureFixture[str]) -> None:
    assert evaluate.main(["builtin:nothing"]) == 2
    assert "unknown built-in motion 'nothing'" in capsys.readouterr().err
    assert evaluate.main(["builtin:stand", "--height", "16"]) == 2
    assert "a person of 16.0 m" in capsys.readouterr().err


def _first_seconds(person: Skeletons, seconds: float) -> Skeletons:
    count = int(np.searchsorted(person.times_s, seconds))
    return Skeletons(person.positions[:count], person.quats_wxyz[:count], person.times_s[:count], person.height_m)
