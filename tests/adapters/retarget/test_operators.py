"""Operators of different sizes are measured, kept by name, and driven by."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adapters.drivers.kinds import BODY, BodyOptions
from adapters.retarget import calibration, operators
from adapters.retarget.calibration import NotCalibrated
from adapters.retarget.human import G1_SIZED, Proportions, of_height, standing
from adapters.retarget.operators import BodyMeasure
from adapters.retarget.scaling import segments
from station.errors import StationError, UsageError
from station.operator.measure import MeasurementResult, OperatorMeasure
from station.operator.sample import OperatorSample
from tests.adapters.retarget.people import ADULT, longer_arms


@pytest.fixture(autouse=True)
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of this user's operators."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    return tmp_path / "station" / "operators"


def seen(lengths: Proportions, metres: float = 0.002) -> list[OperatorSample]:
    """Two seconds of somebody in a T-pose, as a tracker with some noise sees it."""
    random, body = np.random.default_rng(0), standing(lengths)
    return [
        OperatorSample(
            capture_ns=n, body=replace(body, positions=body.positions + random.normal(scale=metres, size=(24, 3)))
        )
        for n in range(144)
    ]


def measured(lengths: Proportions, operator: str = "ada") -> MeasurementResult:
    measure: OperatorMeasure = BodyMeasure()
    return measure.measure(seen(lengths), operator, "t", device="pico", source="a fake")


@pytest.mark.parametrize("height_m", [1.25, 1.5, 1.72, 1.95, 2.15])
@pytest.mark.parametrize("arms", [0.9, 1.1])
def test_each_part_of_somebody_stands_beside_the_robots(height_m: float, arms: float) -> None:
    lengths = longer_arms(of_height(height_m), arms)
    found = measured(lengths)
    assert found.about == f"ada is {found.kept.height_m:.2f} m tall, measured in 144 samples"
    assert found.kept.height_m == pytest.approx(height_m, abs=0.02)
    parts = {
        name: (float(own.split()[0]), float(robot.split()[0]), float(scale)) for name, own, robot, scale in found.rows
    }
    reach = lengths.upper_arm + lengths.forearm + lengths.hand
    assert parts["arm"] == pytest.approx((reach, 0.423, 0.423 / reach), abs=0.01)
    assert parts["leg"] == pytest.approx((lengths.leg, G1_SIZED.leg, G1_SIZED.leg / lengths.leg), abs=0.01)
    assert parts["shoulders, across"][0] == pytest.approx(2 * lengths.shoulder_half_width, abs=0.01)


def test_a_person_of_the_robots_size_has_a_scale_of_one_throughout() -> None:
    assert [part.scale for part in segments(G1_SIZED)] == pytest.approx([1.0] * len(segments(G1_SIZED)))


def test_what_is_kept_is_a_file_that_a_person_can_read_and_the_driver_takes_by_name(settings: Path) -> None:
    pytest.importorskip("mink")
    measure, found = BodyMeasure(), measured(ADULT)
    file = measure.keep(found)
    assert file == settings / "ada.yaml"
    text = file.read_text()
    assert text.startswith("# An operator's body: lengths and heights in metres, angles in radians")
    for line in ("operator: ada", "device: pico", "source: a fake", "height_m: 1.7", "  thigh: 0.42"):
        assert f"\n{line}" in text
    assert calibration.load(file) == found.kept
    told = BODY.make(BodyOptions(height_m=1.2), "ada").facts()["calibration"]
    assert told["sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
    assert (told["operator"], told["file"], told["pose"]) == ("ada", "ada.yaml", "t-pose")
    named = BODY.make(BodyOptions(calibration=file), "").facts()["calibration"]
    assert named == told
    assert BODY.make(BodyOptions(height_m=1.6), "").facts()["calibration"]["height_m"] == 1.6


def test_a_new_measurement_takes_the_place_of_the_one_before_at_once(settings: Path) -> None:
    BodyMeasure().keep(measured(ADULT))
    BodyMeasure().keep(measured(of_height(1.9)))
    assert operators.load("ada")[0].height_m == pytest.approx(1.9, abs=0.02)
    assert [path.name for path in settings.iterdir()] == ["ada.yaml"]


def test_a_body_is_needed_and_its_time() -> None:
    reading = seen(ADULT)[0]
    assert BodyMeasure().why_not(reading) == ""
    assert "the body is not tracked" in BodyMeasure().why_not(replace(reading, body=None))
    assert "does not say when" in BodyMeasure().why_not(replace(reading, capture_ns=None))


@pytest.mark.parametrize(("height_m", "told"), [(1.1, "1.10 m tall, expected 1.2 to 2.2 m"), (2.3, "2.30 m tall")])
def test_somebody_of_an_implausible_height_is_refused(height_m: float, told: str) -> None:
    with pytest.raises(NotCalibrated, match=told):
        measured(of_height(height_m))


def test_another_pose_than_the_one_that_was_asked_for_is_refused() -> None:
    with pytest.raises(NotCalibrated, match="left arm is 90° away from hanging"):
        BodyMeasure().measure(seen(ADULT), "ada", "standing", device="pico", source="")
    with pytest.raises(UsageError, match="pose: 'sitting'; expected t or standing"):
        BodyMeasure().measure(seen(ADULT), "ada", "sitting", device="pico", source="")


@pytest.mark.parametrize("name", ["", "a/b", "..", "../ada", ".ada", " ada", "a\nb", "x" * 101])
def test_what_is_no_name_of_a_file_is_refused(name: str) -> None:
    with pytest.raises(UsageError, match="is no name; expected one as in ada") as caught:
        operators.file_of(name)
    assert "\n" not in str(caught.value)


def test_an_operator_who_was_never_measured_is_told_with_what_to_do() -> None:
    BodyMeasure().keep(measured(ADULT))
    with pytest.raises(StationError, match=r"no calibration of 'adda' \(did you mean 'ada'\?\)") as caught:
        operators.load("adda")
    assert "station devices calibrate pico --operator NAME" in str(caught.value)
    assert "\n" not in str(caught.value)
