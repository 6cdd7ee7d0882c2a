"""Measuring an operator."""

from __future__ import annotations

from dataclasses import astuple, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.retarget import calibration
from adapters.retarget.calibration import NotCalibrated, calibrate, from_height
from adapters.retarget.human import INDEX, of_height, standing
from adapters.retarget.scaling import Scaler
from station import rotations
from station.errors import BadFile
from station.operator.sample import Body
from tests.adapters.retarget.people import ADULT, doing, longer_arms, moved


def second_of(body: Body, metres: float = 0.0) -> list[Body]:
    random = np.random.default_rng(0)
    return [replace(body, positions=body.positions + random.normal(scale=metres, size=(24, 3))) for _ in range(90)]


@pytest.mark.parametrize("pose", ["t-pose", "standing"])
@pytest.mark.parametrize("height_m", [1.5, 1.72, 1.95])
def test_lengths_and_height_are_measured(pose: calibration.Pose, height_m: float) -> None:
    lengths = longer_arms(of_height(height_m), 1.1)
    body = moved(standing(lengths, arms="out" if pose == "t-pose" else "down", heading_rad=0.7), (1.0, -2.0, 0.4))
    found = calibrate(second_of(body, 0.002), "Ada", pose)
    np.testing.assert_allclose(astuple(found.lengths_m), astuple(lengths), atol=0.004)
    assert found.height_m == pytest.approx(height_m, abs=0.02)
    assert found.heading_rad == pytest.approx(0.7, abs=0.02)
    assert found.ankle_rest_z_m == pytest.approx((lengths.ankle_height + 0.4,) * 2, abs=0.002)


@pytest.mark.parametrize(("pose", "arms"), [("t-pose", "out"), ("standing", "down")])
def test_frames_that_are_rest_frames_stay_as_they_are(pose: calibration.Pose, arms: Literal["out", "down"]) -> None:
    found = calibrate(second_of(standing(ADULT, arms=arms, heading_rad=-1.2)), "Ada", pose)
    np.testing.assert_allclose(found.turns(), np.tile(np.eye(3), (24, 1, 1)), atol=1e-4)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), heading=st.floats(-3.0, 3.0), pose=st.sampled_from(["t-pose", "standing"]))
def test_what_zero_the_makers_frames_have_does_not_matter(seed: int, heading: float, pose: calibration.Pose) -> None:
    """Every joint's frame is turned by something unknown; what is asked of the robot stays the same."""
    unknown = rotations.normalized(np.random.default_rng(seed).normal(size=(24, 4)))

    def as_told(body: Body) -> Body:
        return replace(body, quats_wxyz=rotations.multiply(body.quats_wxyz, unknown))

    still = standing(ADULT, arms="out" if pose == "t-pose" else "down", heading_rad=heading)
    truth = Scaler(calibrate(second_of(still), "Ada", pose))
    odd = Scaler(calibrate(second_of(as_told(still)), "Ada", pose))
    body = doing("reach-both").body(150)
    ours, theirs = truth.step(body), odd.step(as_told(body))
    for mine, other in zip(astuple_of(ours), astuple_of(theirs), strict=True):
        np.testing.assert_allclose(mine, other, atol=2e-4)


def astuple_of(aim: object) -> list[np.ndarray]:
    return [getattr(aim, name) for name in aim.__slots__]  # type: ignore[attr-defined]


def test_a_calibration_is_the_same_after_a_file(tmp_path: Path) -> None:
    made = calibrate(second_of(standing(ADULT)), "Ada", "t-pose")
    path = tmp_path / "operators" / "ada.yaml"
    calibration.save(made, path)
    assert calibration.load(path) == made
    assert "thigh: 0.42" in path.read_text()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("operator: Ada\n", "missing required field"),
        ("{", "not an operator's calibration"),
        ("", "not an operator's calibration"),
        ("\xff\xfe", "not an operator's calibration"),
    ],
)
def test_a_file_that_is_none_is_told_in_one_line(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "ada.yaml"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(BadFile, match=told) as caught:
        calibration.load(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_file_with_lengths_that_nobody_has_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "ada.yaml"
    calibration.save(from_height(1.7), path)
    path.write_text(path.read_text().replace("forearm: 0.2482", "forearm: 2.482"))
    with pytest.raises(BadFile, match=r"forearm is 2\.48 m"):
        calibration.load(path)


def test_a_file_that_is_not_there_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(BadFile, match="measure the operator first"):
        calibration.load(tmp_path / "nobody.yaml")


def _bent(joint: str, shift: tuple[float, float, float]) -> Body:
    body = standing(ADULT)
    positions = body.positions.copy()
    positions[INDEX[joint]] += shift
    return replace(body, positions=positions)


@pytest.mark.parametrize(
    ("bodies", "pose", "told"),
    [
        (second_of(standing(ADULT))[:10], "t-pose", "10 samples"),
        (second_of(standing(ADULT), 0.02), "t-pose", "stand still"),
        (second_of(standing(ADULT, arms="down")), "t-pose", "left arm is 90° away from straight out"),
        (second_of(standing(ADULT)), "standing", "left arm is 90° away from hanging"),
        (second_of(_bent("right_wrist", (0.3, 0.5, 0.0))), "t-pose", "right arm"),
        (second_of(_bent("left_knee", (0.3, 0.0, 0.0))), "t-pose", "left leg is not straight"),
        (second_of(_bent("left_elbow", (0.0, -0.15, 0.0))), "t-pose", "shoulder to elbow is"),
        (second_of(standing(of_height(0.6))), "t-pose", "0.60 m tall"),
        (second_of(replace(standing(ADULT), positions=np.zeros((24, 3)))), "t-pose", "lost"),
        (second_of(replace(standing(ADULT), quats_wxyz=np.zeros((24, 4)))), "t-pose", "lost"),
        (second_of(replace(standing(ADULT), positions=np.full((24, 3), np.nan))), "t-pose", "not finite"),
        (second_of(doing("bow").body(200)), "standing", "leans"),
    ],
)
def test_what_cannot_be_measured_is_told_in_one_line(bodies: list[Body], pose: calibration.Pose, told: str) -> None:
    with pytest.raises(NotCalibrated, match=told) as caught:
        calibrate(bodies, "Ada", pose)
    assert "\n" not in str(caught.value)
