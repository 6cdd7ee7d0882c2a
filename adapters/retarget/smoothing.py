"""A filter over a tracked body whose latency is known: little where something moves, much smoothing where it rests.

Each joint has a low-pass of first order whose cutoff rises with the joint's own speed (the "1 euro filter" of Casiez,
Roussel and Vogel, CHI 2012). A joint that moves steadily is seen late by `latency_s` of its speed: with the defaults by
40 ms in the limit of standing still, 9 ms at 0.7 m/s and 4 ms at 2 m/s; 20 ms at 1 rad/s and 11 ms at 2.5 rad/s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from station import rotations
from station.operator.sample import Body
from station.protocols import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Smoothness:
    """How much is smoothed.

    Attributes:
        rest_hz: Cutoff for what does not move [Hz].
        per_mps: How much it rises with a joint's speed [Hz s/m].
        per_rad_s: How much that of its orientation rises with its turning [Hz s/rad].
        speed_hz: Cutoff of the estimate of speeds [Hz].
    """

    rest_hz: float = 4.0
    per_mps: float = 20.0
    per_rad_s: float = 4.0
    speed_hz: float = 3.0

    def latency_s(self, speed_mps: float) -> float:
        """Return how late a joint is seen that moves at a steady speed [s]; half a period less right at a sample."""
        return 1.0 / (2.0 * math.pi * (self.rest_hz + self.per_mps * speed_mps))

    def turn_latency_s(self, speed_rad_s: float) -> float:
        """Return how late a joint is seen that turns at a steady speed [s]."""
        return 1.0 / (2.0 * math.pi * (self.rest_hz + self.per_rad_s * speed_rad_s))


class BodySmoother:
    """Smooths positions and orientations of the 24 joints.

    Args:
        smoothness: How much.
    """

    def __init__(self, smoothness: Smoothness | None = None) -> None:
        self._how = smoothness or Smoothness()
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next body passes as it is."""
        self._last: Body | None = None
        self._raw: Body | None = None

    def latency_s(self, speed_mps: float) -> float:
        """Return how late a joint is seen that moves at a steady speed [s]."""
        return self._how.latency_s(speed_mps)

    def step(self, body: Body, dt_s: float) -> Body:
        """Return the smoothed body.

        Args:
            body: New, not seen before.
            dt_s: Time since the last one, by the device's clock [s].
        """
        if self._last is None or self._raw is None:
            self._velocity = np.zeros_like(body.positions)
            self._turning = np.zeros_like(body.positions)
            self._last = self._raw = body
            return body
        how, speed_share = self._how, _share(np.array(self._how.speed_hz), dt_s)
        moved = (body.positions - self._raw.positions) / dt_s
        turned = rotations.rotation_vector(
            rotations.multiply(body.quats_wxyz, rotations.inverse(self._raw.quats_wxyz))
        ) / dt_s  # fmt: skip
        self._velocity = self._velocity + (moved - self._velocity) * speed_share
        self._turning = self._turning + (turned - self._turning) * speed_share
        place = _share(how.rest_hz + how.per_mps * np.linalg.norm(self._velocity, axis=1), dt_s)
        turn = _share(how.rest_hz + how.per_rad_s * np.linalg.norm(self._turning, axis=1), dt_s)
        last, self._raw = self._last, body
        self._last = Body(
            last.positions + (body.positions - last.positions) * place[:, None],
            rotations.slerp(last.quats_wxyz, body.quats_wxyz, turn),
        )
        return self._last


def _share(cutoff_hz: Floats, dt_s: float) -> Floats:
    """How much of the way to a new value a low-pass goes in one step."""
    # Exact for a value held since the last sample, so the latency does not depend on the rate.
    return np.asarray(-np.expm1(-2.0 * math.pi * cutoff_hz * dt_s))
