"""Calibrations of leaders: the joints they make, the turns, the files."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adapters.devices.gello import calibration as calibrations
from adapters.devices.gello.calibration import QUARTER, Calibration, GripperCalibration, JointCalibration
from station.errors import BadFile
from station.operator.device import DeviceError


def made(joints: int = 3, **changes: object) -> Calibration:
    known = Calibration(
        serial="FT1",
        arm="left",
        date="2026-11-21",
        joints=tuple(
            JointCalibration(id=index + 1, name=f"joint_{index + 1}", model=1200, sign=1 if index % 2 else -1,
                             offset_rad=index * QUARTER, reference_rad=0.5 * index)
            for index in range(joints)
        ),
        gripper=GripperCalibration(id=joints + 1, model=1190, open_rad=3.0, closed_rad=2.0),
    )  # fmt: skip
    return msgspec.structs.replace(known, **changes)


def servos_of(calibration: Calibration, joints: np.ndarray, gripper: float) -> np.ndarray:
    assert calibration.gripper is not None
    shown = [each.offset_rad + each.sign * q for each, q in zip(calibration.joints, joints, strict=True)]
    travel = calibration.gripper.closed_rad - calibration.gripper.open_rad
    return np.array([*shown, calibration.gripper.open_rad + gripper * travel])


@given(
    joints=st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3).map(np.array),
    lost=st.lists(st.integers(-3, 3), min_size=4, max_size=4).map(np.array),
    gripper=st.floats(0.0, 1.0),
)
def test_joints_come_back_on_the_turn_of_the_reference_whatever_turns_were_lost(
    joints: np.ndarray, lost: np.ndarray, gripper: float
) -> None:
    calibration = made()
    reference = np.array([joint.reference_rad for joint in calibration.joints])
    near = reference + np.clip(joints, -3.0, 3.0)  # less than half a turn away
    servos = servos_of(calibration, near, gripper) + math.tau * lost
    values = calibration.values(servos, calibration.turns(servos))
    np.testing.assert_allclose(values[:3], near, atol=1e-9)
    assert values[3] == pytest.approx(gripper, abs=1e-9)


def test_the_turns_of_the_start_are_kept_while_a_joint_goes_further() -> None:
    calibration = made()
    start = servos_of(calibration, np.zeros(3), 0.0)
    turns = calibration.turns(start)
    on = calibration.values(servos_of(calibration, np.array([4.0, -4.0, 0.0]), 0.0), turns)
    assert on[:3].tolist() == pytest.approx([4.0, -4.0, 0.0])


def test_a_gripper_ends_at_open_and_closed() -> None:
    calibration = made()
    for gripper, told in ((-0.2, 0.0), (0.25, 0.25), (1.3, 1.0)):
        servos = servos_of(calibration, np.zeros(3), gripper)
        assert calibration.values(servos, np.zeros(3))[-1] == pytest.approx(told)


@given(
    quarters=st.integers(-16, 16), joint=st.floats(-3.0, 3.0), off=st.floats(-0.7, 0.7), sign=st.sampled_from([1, -1])
)
def test_the_offset_is_the_quarter_turn_nearest_to_a_known_pose(
    quarters: int, joint: float, off: float, sign: int
) -> None:
    shown = quarters * QUARTER + sign * (joint + off)
    assert calibrations.nearest_offset(shown, joint, sign) == pytest.approx(quarters * QUARTER)


def test_names_say_which_arm() -> None:
    assert made(2).names == ("left_joint_1", "left_joint_2", "left_gripper")
    assert made(2, gripper=None, arm="right").names == ("right_joint_1", "right_joint_2")


def test_a_calibration_is_read_as_it_was_written(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "gello"
    assert calibrations.save(folder, made()) == folder / "FT1.yaml"
    assert calibrations.load(folder, "FT1") == made()
    assert [path.name for path in folder.iterdir()] == ["FT1.yaml"]


def test_a_leader_without_a_calibration_is_told_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=r"leader FT2 has no calibration .*station devices calibrate gello"):
        calibrations.load(tmp_path, "FT2")


def test_the_calibration_of_another_leader_is_refused(tmp_path: Path) -> None:
    calibrations.save(tmp_path, made()).rename(tmp_path / "FT2.yaml")
    with pytest.raises(BadFile, match=r"is the calibration of leader FT1, expected that of FT2"):
        calibrations.load(tmp_path, "FT2")


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("sign: -1", "sign: 2", "sign is 2; expected 1 or -1"),
        ("closed_rad: 2.0", "closed_rad: 2.95", "moves less than 10°"),
        ("arm: left", "arm: third", "Invalid enum value 'third'"),
        ("id: 2", "id: 1", "an id comes twice"),
        ("offset_rad: 0.0", "offset_rad: .nan", "must be finite"),
        ("serial: FT1", "serial: FT1\nspeed: 3", "unknown field `speed`"),
        ("serial: FT1", "serial: [", "no calibration of a leader"),
    ],
)
def test_a_file_that_is_no_calibration_is_one_line(tmp_path: Path, old: str, new: str, told: str) -> None:
    file = calibrations.save(tmp_path, made())
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(BadFile) as caught:
        calibrations.load(tmp_path, "FT1")
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_servos_are_named_with_their_joints() -> None:
    with pytest.raises(DeviceError, match=r"no answer from servo 2 \(joint_2\), 4 \(gripper\); 1, 3 of 4 answer"):
        made().check({1: 1200, 3: 1200}, "/dev/ttyUSB0")


def test_a_servo_of_another_model_is_named() -> None:
    with pytest.raises(DeviceError, match=r"servo 3 \(joint_3\) is a XM430-W350, but .* FT1 says XL330-M288"):
        made().check({1: 1200, 2: 1200, 3: 1020, 4: 1190}, "/dev/ttyUSB0")


def test_calibrations_are_kept_with_the_users_settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert calibrations.default_folder() == tmp_path / "station" / "gello"
