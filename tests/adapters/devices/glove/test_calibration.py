"""Calibrations of gloves: how far closed a number is, names of sensors, the files."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adapters.devices.glove import calibration as calibrations
from adapters.devices.glove.calibration import Calibration, SensorCalibration
from adapters.devices.glove.sensors import FINGERS, PRESETS, why_not
from station.errors import BadFile
from station.operator.device import DeviceError


def made(**changes: object) -> Calibration:
    known = Calibration(
        serial="GL1", side="left", date="2026-11-21", protocol="numbers", numbers=4,
        sensors=(
            SensorCalibration(name="index_0", number=2, open=100.0, closed=300.0),
            SensorCalibration(name="thumb", number=0, open=900.0, closed=500.0),
        ),
    )  # fmt: skip
    return msgspec.structs.replace(known, **changes)


def test_a_sensor_may_rise_or_fall_as_the_hand_closes_and_ends_at_0_and_1() -> None:
    calibration = made()
    assert calibration.names == ("index_0", "thumb")
    assert calibration.values((900.0, 7.0, 100.0, 7.0)).tolist() == [0.0, 0.0]
    assert calibration.values((500.0, 7.0, 300.0, 7.0)).tolist() == [1.0, 1.0]
    assert calibration.values((800.0, 7.0, 250.0, 7.0)).tolist() == [0.75, 0.25]
    assert calibration.values((2000.0, 7.0, -50.0, 7.0)).tolist() == [0.0, 0.0]
    assert calibration.values((0.0, 7.0, 4095.0, 7.0)).tolist() == [1.0, 1.0]


@given(st.lists(st.floats(-1e9, 1e9), min_size=4, max_size=4))
def test_no_number_closes_a_sensor_further_than_0_to_1(line: list[float]) -> None:
    values = made().values(line)
    assert values.shape == (2,)
    assert ((values >= 0.0) & (values <= 1.0)).all()


def test_a_calibration_is_read_as_it_was_written(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "glove"
    assert calibrations.save(folder, made()) == folder / "GL1-left.yaml"
    assert calibrations.load(folder, "GL1", "left") == made()
    assert [path.name for path in folder.iterdir()] == ["GL1-left.yaml"]


def test_a_glove_without_a_calibration_is_told_how_to_make_one(tmp_path: Path) -> None:
    calibrations.save(tmp_path, made())
    told = r"glove GL1 has no calibration for the right hand .*: station devices calibrate glove --side right"
    with pytest.raises(DeviceError, match=told):
        calibrations.load(tmp_path, "GL1", "right")


def test_the_calibration_of_another_glove_is_refused(tmp_path: Path) -> None:
    calibrations.save(tmp_path, made()).rename(tmp_path / "GL2-right.yaml")
    with pytest.raises(BadFile, match="is the calibration of the left glove GL1, expected that of the right glove GL2"):
        calibrations.load(tmp_path, "GL2", "right")


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("closed: 300.0", "closed: 100.0", "sensor index_0 shows 100 open and 100 closed; expected two numbers"),
        ("closed: 300.0", "closed: .nan", "sensor index_0 shows 100 open and nan closed"),
        ("number: 2", "number: 4", "sensors are the numbers 4, 0 of the line; expected each of 0 to 3 at most once"),
        ("number: 2", "number: -1", "expected each of 0 to 3"),
        ("number: 2", "number: 0", "sensors are the numbers 0, 0"),
        ("numbers: 4", "numbers: 0", "numbers is 0; expected 1 to 64"),
        ("name: thumb", "name: index_0", "sensor index_0 comes twice"),
        ("name: thumb", "name: pinky", "'pinky' is no sensor; expected one of thumb, index"),
        ("side: left", "side: third", "Invalid enum value 'third'"),
        ("protocol: numbers", "protocol: morse", "Invalid enum value 'morse'"),
        ("serial: GL1", "serial: GL1\nspeed: 3", "unknown field `speed`"),
        ("serial: GL1", "serial: [", "no calibration of a glove"),
    ],
)
def test_a_file_that_is_no_calibration_is_one_line(tmp_path: Path, old: str, new: str, told: str) -> None:
    file = calibrations.save(tmp_path, made())
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(BadFile) as caught:
        calibrations.load(tmp_path, "GL1", "left")
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_sensors_are_fingers_from_the_knuckle_to_the_tip() -> None:
    assert why_not([*FINGERS, *PRESETS[15], "thumb_rotation"]) == ""
    assert PRESETS[15][:4] == ("thumb_0", "thumb_1", "thumb_2", "index_0")
    for wrong in ("index_3", "index_", "Index", "index_rotation", "-", ""):
        assert "is no sensor" in why_not(["thumb", wrong])
    assert why_not([]) == "no sensor is named; expected at least one"


def test_calibrations_are_kept_with_the_users_settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert calibrations.default_folder() == tmp_path / "station" / "glove"
