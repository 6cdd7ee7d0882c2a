"""The driver `velocity`: whatever an operator holds becomes the velocity of a robot on legs, and zero when let go."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
import numpy as np
import pytest

from adapters.drivers.velocity import RISES_S, VelocityDriver, VelocityOptions
from station import registry
from station.operator.deadman import Snapshot
from station.operator.driver import DriverKind
from station.operator.sample import OperatorSample
from station.protocols import Floats

DT = 0.02
SPEEDS = {"forward_mps": 0.6, "left_mps": 0.4, "turn_rad_s": 1.0}


class Wheel:
    """Somebody who drives."""

    def __init__(self, **options: float | str) -> None:
        self.driver = VelocityDriver(VelocityOptions(robot="go2", **(SPEEDS | options)))
        self.snapshot: Snapshot[object, object] | None = None

    def engage(self, sample: OperatorSample) -> Floats:
        self.snapshot = Snapshot(self.driver.inspect(sample).input, self.driver.target)
        return self.driver.step(sample, self.snapshot, DT)

    def hold(self, sample: OperatorSample | None, seconds: float) -> list[Floats]:
        return [self.driver.step(sample, self.snapshot, DT) for _ in range(round(seconds / DT))]


def controls(**pressed: float) -> OperatorSample:
    return OperatorSample(controls=pressed)


def twisted(*twist: float) -> OperatorSample:
    return OperatorSample(controls={"button_0": 0.0}, twist=np.array(twist))


@pytest.mark.parametrize(
    ("sample", "expected"),
    [
        (controls(left_stick_y=1.0), [0.6, 0.0, 0.0]),
        (controls(left_stick_y=-1.0, left_stick_x=1.0), [-0.6, -0.4, 0.0]),
        (controls(right_stick_x=-1.0), [0.0, 0.0, 1.0]),
        (controls(left_stick_y=0.1, right_stick_x=0.1), [0.0, 0.0, 0.0]),
        (controls(key_w=1.0, key_d=1.0), [0.6, 0.0, -1.0]),
        (controls(key_s=1.0, key_j=1.0), [-0.6, 0.4, 0.0]),
        (twisted(0.5, -1.0, 0.9, 0.9, 0.9, 0.25), [0.3, -0.4, 0.25]),
        (OperatorSample(controls={"key_w": 1.0}, twist=np.full(6, np.nan)), [0.6, 0.0, 0.0]),
        (twisted(9.0, 0.0, 0.0, 0.0, 0.0, -9.0), [0.6, 0.0, -1.0]),
    ],
)
def test_each_device_says_how_fast(sample: OperatorSample, expected: list[float]) -> None:
    wheel = Wheel()
    assert wheel.driver.inspect(sample).why_not == ""
    wheel.engage(sample)
    np.testing.assert_allclose(wheel.hold(sample, 1.0)[-1], expected, atol=1e-12)


def test_a_key_that_goes_down_at_once_is_a_ramp_and_letting_go_is_zero_within_the_fade() -> None:
    wheel, forward = Wheel(), controls(key_w=1.0)
    assert not wheel.engage(forward).any(), "the first command is the one before it"
    rise = np.array(wheel.hold(forward, 1.0))[:, 0]
    assert np.diff(rise).max() <= 0.6 * DT / RISES_S + 1e-12
    assert rise[round(RISES_S / DT)] == pytest.approx(0.6)
    wheel.snapshot = None
    fall = np.array(wheel.hold(forward, 0.3))[:, 0]
    assert np.diff(fall).min() >= -0.6 * DT / 0.2 - 1e-12
    assert fall[9] == 0.0, "200 ms after it was let go"
    assert wheel.driver.is_still


def test_a_device_that_falls_silent_brings_it_to_a_stand() -> None:
    wheel, forward = Wheel(), controls(key_w=1.0)
    wheel.engage(forward)
    wheel.hold(forward, 1.0)
    assert not wheel.hold(None, 1.0)[-1].any()


def test_what_another_writer_asked_for_is_gone_on_from() -> None:
    wheel = Wheel()
    wheel.driver.resume_from(np.array([0.5, 0.0, -9.0]))
    np.testing.assert_array_equal(wheel.engage(controls(key_w=1.0)), [0.5, 0.0, -3.0])
    np.testing.assert_allclose(wheel.hold(controls(key_w=1.0), 1.0)[-1], [0.6, 0.0, 0.0], atol=1e-12)


def test_a_device_without_controls_says_what_it_lacks() -> None:
    look = Wheel().driver.inspect(OperatorSample())
    assert (look.input, look.why_not) == (None, "the device sends no controls")
    assert Wheel().driver.inspect(OperatorSample(twist=np.full(6, np.nan))).input is None


def test_it_is_registered_and_commands_the_robot_that_is_named() -> None:
    kind: DriverKind = registry.find("driver", "velocity")
    driver = kind.make(VelocityOptions(robot="h1"), "")
    assert driver.command_format.key == "action_velocity_h1"
    assert driver.facts() == {
        "driver": "velocity", "robot": "h1", "format": "velocity", "forward_mps": 0.7, "left_mps": 0.4,
        "turn_rad_s": 0.8,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "robot"),
        ({"robot": ""}, "robot is empty"),
        ({"robot": "go2", "left_mps": 9}, "left_mps is 9; expected 0 to 3"),
    ],
)
def test_options_that_cannot_be_are_refused(options: Mapping[str, object], words: str) -> None:
    with pytest.raises(msgspec.ValidationError, match=words):
        msgspec.convert(options, VelocityOptions)


@pytest.mark.parametrize(
    ("down", "up"),
    [
        (controls(right_stick_y=-1.0), controls(right_stick_y=1.0)),
        (controls(key_k=1.0), controls(key_i=1.0)),
        (twisted(0, 0, -1.0, 0, 0, 0), twisted(0, 0, 1.0, 0, 0, 0)),
    ],
)
def test_where_the_format_has_a_height_it_is_raised_and_lowered_and_stays_where_it_was_left(
    down: OperatorSample, up: OperatorSample
) -> None:
    wheel = Wheel(format="velocity-height")
    assert wheel.engage(down).tolist() == [0.0, 0.0, 0.0, 0.74]
    assert wheel.hold(down, 1.0)[-1][3] == pytest.approx(0.54), "0.2 m/s"
    wheel.snapshot = None
    assert wheel.hold(None, 1.0)[-1][3] == pytest.approx(0.54)
    wheel.engage(up)
    assert wheel.hold(up, 5.0)[-1][3] == 0.80
    wheel.driver.resume_from(np.array([0.2, 0.0, 0.0, 0.3]))
    wheel.snapshot = None
    assert wheel.hold(None, 1.0)[-1].tolist() == [0.0, 0.0, 0.0, 0.3]


def test_a_torso_is_left_upright_and_a_format_of_no_velocities_is_refused() -> None:
    wheel = Wheel(format="velocity-posture")
    assert wheel.engage(controls(right_stick_y=-1.0))[4:].tolist() == [0.0, 0.0, 0.0]
    with pytest.raises(ValueError, match=r"format is 'velocity-heigt' \(did you mean 'velocity-height'\?\); expected"):
        VelocityOptions(robot="g1", format="velocity-heigt")
