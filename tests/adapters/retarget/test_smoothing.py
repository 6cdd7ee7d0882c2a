"""The filter: its latency is what it says, its noise less than what comes in."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.retarget.human import standing
from adapters.retarget.smoothing import BodySmoother, Smoothness
from station import rotations
from station.operator.sample import Body
from station.protocols import Floats
from tests.adapters.retarget.people import ADULT

STILL = standing(ADULT)


def sliding(time_s: float, speed_mps: float, turning_rad_s: float = 0.0) -> Body:
    turn = rotations.from_rotation_vector(np.array([0.0, 0.0, turning_rad_s * time_s]))
    shift = np.array([speed_mps * time_s, 0.0, 0.0])
    return Body(STILL.positions + shift, rotations.multiply(turn[None], STILL.quats_wxyz))


def sampled(latency_s: float, dt_s: float) -> float:
    """What a low-pass of a latency is late by at the instants of its samples: about half a period less."""
    return float(dt_s / np.expm1(dt_s / latency_s))


@pytest.mark.parametrize("rate_hz", [72.0, 90.0])
@pytest.mark.parametrize("speed_mps", [0.1, 0.7, 2.0])
def test_what_moves_is_as_late_as_documented(speed_mps: float, rate_hz: float) -> None:
    how, dt_s = Smoothness(), 1.0 / rate_hz
    smoother = BodySmoother(how)
    for frame in range(200):
        now = sliding(frame * dt_s, speed_mps)
        seen = smoother.step(now, dt_s)
    late_s = (now.positions[5, 0] - seen.positions[5, 0]) / speed_mps
    assert late_s == pytest.approx(sampled(how.latency_s(speed_mps), dt_s), abs=2e-4)


def test_what_turns_is_as_late_as_documented() -> None:
    how, dt_s = Smoothness(), 1.0 / 90.0
    smoother = BodySmoother(how)
    for frame in range(300):
        now = sliding(frame * dt_s, 0.0, 1.0)
        seen = smoother.step(now, dt_s)
    behind = rotations.multiply(rotations.inverse(seen.quats_wxyz[0]), now.quats_wxyz[0])
    late_s = float(rotations.rotation_vector(behind)[2])
    assert late_s == pytest.approx(sampled(how.turn_latency_s(1.0), dt_s), abs=2e-4)


def test_noise_of_somebody_who_stands_is_reduced_to_less_than_half() -> None:
    smoother, random = BodySmoother(), np.random.default_rng(0)
    noise = random.normal(scale=0.002, size=(400, 24, 3))
    seen: list[Floats] = [
        smoother.step(Body(STILL.positions + shift, STILL.quats_wxyz), 1.0 / 90.0).positions - STILL.positions
        for shift in noise
    ]
    assert np.std(seen[50:]) < 0.5 * np.std(noise)


def test_the_first_body_passes_as_it_is_and_after_a_reset_again() -> None:
    smoother = BodySmoother()
    assert smoother.step(STILL, 0.01) is STILL
    smoother.step(sliding(1.0, 1.0), 0.01)
    smoother.reset()
    assert smoother.step(STILL, 0.01) is STILL


def test_orientations_stay_unit_quaternions_across_a_change_of_sign() -> None:
    smoother = BodySmoother()
    for frame in range(50):
        body = sliding(frame / 90.0, 0.0, 3.0)
        seen = smoother.step(Body(body.positions, body.quats_wxyz * (-1.0) ** frame), 1.0 / 90.0)
    np.testing.assert_allclose(np.linalg.norm(seen.quats_wxyz, axis=1), 1.0, atol=1e-12)
    behind = rotations.multiply(rotations.inverse(seen.quats_wxyz[0]), body.quats_wxyz[0])
    assert np.linalg.norm(rotations.rotation_vector(behind)) < 0.1
