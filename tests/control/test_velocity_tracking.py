"""What counts as the velocity of a base, and how far it is from the commanded one."""

from __future__ import annotations

import numpy as np
import pytest

from station.control.tracking import VELOCITIES, VelocityTracking
from station.protocols import Floats
from station.rotations import from_rotation_vector, multiply

DT = 0.02
LEAN = multiply(from_rotation_vector([0, -0.3, 0]), from_rotation_vector([0.2, 0, 0]))


def walked(tracking: VelocityTracking, commanded: Floats, does: Floats, *, sways: float = 0.0, first: int = 0) -> None:
    """Add ticks in which a base moves as `does` in its heading frame, swaying once a second, shapes (n, 3)."""
    place, yaw = np.array([3.0, -2.0, 0.8]), 2.5  # it passes the half turn
    for index, (asked, velocity) in enumerate(zip(commanded, does, strict=True)):
        quat = multiply(from_rotation_vector([0, 0, yaw]), LEAN)
        tracking.add(first + index, index * DT, asked, place, quat)
        middle = yaw + velocity[2] * DT / 2
        side = velocity[1] + sways * np.cos(2 * np.pi * index * DT)
        forward, left = np.array([np.cos(middle), np.sin(middle)]), np.array([-np.sin(middle), np.cos(middle)])
        place = place + DT * np.array([*(velocity[0] * forward + side * left), 0.1])
        yaw += velocity[2] * DT


def constant(vx: float, vy: float, wz: float, seconds: float) -> Floats:
    return np.tile([vx, vy, wz], (round(seconds / DT), 1))


def test_each_stretch_is_measured_from_a_second_and_a_half_after_it_began() -> None:
    tracking = VelocityTracking(VELOCITIES, DT)
    commanded = np.concatenate([constant(0.5, 0, 0, 6), constant(0, 0.3, -0.8, 6), constant(0, 0, 0, 1)])
    does = np.concatenate([constant(0, 0, 0, 1.4), constant(0.4, 0.1, 0, 4.6), constant(0, 0.2, -0.7, 7)])
    walked(tracking, commanded, does, sways=0.3)
    found = tracking.found()
    assert found is not None
    assert len(found.stretches) == 2, "one of a second is too short to be measured"
    first, second = found.stretches
    assert first.commanded == (0.5, 0.0, 0.0)
    np.testing.assert_allclose(first.measured, [0.4, 0.1, 0.0], atol=0.04)
    np.testing.assert_allclose(second.measured, [0.0, 0.2, -0.7], atol=0.04)
    assert (first.seconds, second.seconds) == (pytest.approx(6.0), pytest.approx(6.0))
    assert second.at_s == pytest.approx(6.0)
    assert "commanded +0.50  +0.00  +0.00" in list(found.lines())[1]


def test_curves_are_means_over_a_second_at_its_middle_and_a_gap_is_a_row_that_is_no_number() -> None:
    tracking = VelocityTracking(VELOCITIES, DT)
    walked(tracking, constant(0.5, 0, 0, 4), constant(0.4, 0.1, 0, 4), sways=0.5)
    walked(tracking, constant(0, 0, 0, 2), constant(0, 0, 0.2, 2), first=1000)
    curves = tracking.curves()
    (gap,) = np.flatnonzero(np.isnan(curves[:, 0]))
    first, second = curves[:gap], curves[gap + 1 :]
    assert len(first) == round(3 / DT)
    assert (first[0, 0], first[-1, 0]) == (pytest.approx(0.48), pytest.approx(3.46))
    np.testing.assert_allclose(first[:, 1:4], [[0.5, 0, 0]] * len(first))
    np.testing.assert_allclose(first[:, 4:], [[0.4, 0.1, 0]] * len(first), atol=0.02)
    np.testing.assert_allclose(second[:, 4:], [[0, 0, 0.2]] * len(second), atol=1e-6)
    assert VelocityTracking(VELOCITIES, DT).curves().shape == (0, 7)


def test_a_gait_that_sways_is_no_error_and_what_is_missing_is() -> None:
    tracking = VelocityTracking(VELOCITIES, DT)
    walked(tracking, constant(0.5, 0, 0.4, 10), constant(0.4, 0, 0.35, 10), sways=0.5)
    found = tracking.found()
    assert found is not None
    np.testing.assert_allclose(found.error, [0.1, 0.0, 0.05], atol=2e-3)


def test_ticks_that_do_not_follow_on_are_not_put_together() -> None:
    tracking = VelocityTracking(VELOCITIES, DT)
    walked(tracking, constant(0.5, 0, 0, 4), constant(0.5, 0, 0, 4))
    walked(tracking, constant(0.5, 0, 0, 4), constant(0.5, 0, 0, 4), first=1000)  # begins elsewhere
    found = tracking.found()
    assert found is not None
    np.testing.assert_allclose(found.error, np.zeros(3), atol=1e-9)
    assert [each.seconds for each in found.stretches] == [pytest.approx(4.0 - DT)] * 2


def test_a_command_without_velocities_and_a_moment_say_nothing() -> None:
    other = VelocityTracking(("root_height", "left_knee_pos"), DT)
    other.add(0, 0.0, np.zeros(2), np.zeros(3), np.array([1.0, 0, 0, 0]))
    assert other.found() is None
    short = VelocityTracking(VELOCITIES, DT)
    walked(short, constant(0.5, 0, 0, 0.9), constant(0.5, 0, 0, 0.9))
    assert short.found() is None
    assert VelocityTracking(VELOCITIES, DT).found() is None
