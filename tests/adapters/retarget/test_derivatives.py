"""Velocities of the root."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.retarget.pipeline import RootVelocity
from station import rotations


def yawed(angle_rad: float) -> np.ndarray:
    return rotations.from_rotation_vector(np.array([0.0, 0.0, angle_rad]))


@settings(max_examples=50, deadline=None)
@given(
    gaps_ms=st.lists(st.floats(2.0, 40.0), min_size=4, max_size=40),
    speed=st.floats(-2.0, 2.0),
    heading=st.floats(-3.0, 3.0),
)
def test_a_steady_velocity_is_found_exactly_however_uneven_the_samples(
    gaps_ms: list[float], speed: float, heading: float
) -> None:
    velocity, time_s = RootVelocity(), 5.0
    for gap_ms in gaps_ms:
        time_s += gap_ms / 1e3
        world = np.array([np.cos(heading), np.sin(heading), 0.0]) * speed * time_s
        linear, angular = velocity.step(world, yawed(heading), time_s)
    np.testing.assert_allclose(linear, [speed, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(angular, 0.0, atol=1e-9)


@pytest.mark.parametrize("rate", [-2.0, 0.5, 3.0])
def test_a_steady_turn_is_found_with_its_sign_through_all_headings(rate: float) -> None:
    velocity = RootVelocity()
    for frame in range(400):
        _, angular = velocity.step(np.zeros(3), yawed(rate * frame / 90.0), frame / 90.0)
        if frame > 1:
            np.testing.assert_allclose(angular, [0.0, 0.0, rate], atol=1e-6)


def test_a_change_of_speed_is_seen_half_a_window_late() -> None:
    velocity = RootVelocity(window_s=0.06)
    found = []
    for frame in range(300):
        time_s = frame / 100.0
        found.append(velocity.step(np.array([0.5 * time_s**2, 0.0, 0.0]), yawed(0.0), time_s)[0][0])
    late_s = 299 / 100.0 - found[-1]
    assert late_s == pytest.approx(velocity.latency_s, abs=1e-6)


def test_it_begins_at_zero_and_after_a_reset_again() -> None:
    velocity = RootVelocity()
    for _ in range(2):
        linear, angular = velocity.step(np.array([3.0, 0.0, 0.0]), yawed(1.0), 1.0)
        assert not linear.any()
        assert not angular.any()
        velocity.step(np.array([4.0, 0.0, 0.0]), yawed(1.0), 1.1)
        velocity.reset()
