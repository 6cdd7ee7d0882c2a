"""Which foot carries, and where it is held: feet on the floor stand still, whatever the tracking says of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from adapters.retarget.scaling import LinkTargets, level
from adapters.robots.g1 import kinematics
from station.protocols import Floats

SOLE_DEPTH_M = float(-kinematics.SOLE_POINTS[0, 2])


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactRules:
    """When a foot carries. Heights and speeds are in robot size.

    Attributes:
        low_m, high_m: A sole below the one comes to carry, above the other no longer does [m].
        slow_mps, fast_mps: The same for its speed over the floor [m/s].
        blend_s: From going where the operator's foot goes to being held, and back [s].
        speed_s: Time constant of the estimate of speeds [s].
        floor_s: Time constant with which the floor follows the lower foot while that stands still [s].
        let_go_m: A held foot that the operator's has left by so much is let go [m].
        least_lift_m, most_lift_m: What both feet are above the floor is a jump from the one on, and cut at the other.
    """

    low_m: float = 0.02
    high_m: float = 0.04
    slow_mps: float = 0.2
    fast_mps: float = 0.4
    blend_s: float = 0.08
    speed_s: float = 0.03
    floor_s: float = 0.5
    let_go_m: float = 0.06
    least_lift_m: float = 0.03
    most_lift_m: float = 0.3


class FootHold:
    """Holds the feet that carry, and lifts the body where both have left the floor.

    Args:
        rules: When a foot carries.
    """

    def __init__(self, rules: ContactRules | None = None) -> None:
        self._rules = rules or ContactRules()
        self.reset()

    def reset(self) -> None:
        """Forget everything, as before the first sample."""
        self.carries: NDArray[np.bool_] = np.zeros(2, dtype=bool)
        self._held = np.zeros((2, 3))
        self._share = np.zeros(2)
        self._speed = np.full(2, np.inf)
        self._before: Floats | None = None
        self._floor_m = 0.0

    def step(self, aim: LinkTargets, dt_s: float) -> LinkTargets:
        """Return the aim with its feet held; `carries` says which, shape (2,).

        Args:
            aim: What the operator does.
            dt_s: Time since the last one, by the device's clock [s].
        """
        self._measure(aim, dt_s)
        heights = aim.soles - self._floor_m
        lift_m = float(np.clip(heights.min() - self._rules.least_lift_m, 0.0, self._rules.most_lift_m))
        lifted = np.array([0.0, 0.0, lift_m])
        ankles = aim.ankles + lifted
        self._judge(heights, ankles)
        gain = dt_s / self._rules.blend_s
        self._share = np.clip(self._share + np.where(self.carries, gain, -gain), 0.0, 1.0)
        share = self._share[:, None]
        return replace(
            aim,
            pelvis=aim.pelvis + lifted,
            ankles=ankles * (1.0 - share) + self._held * share,
            feet_turn=level(aim.feet_turn, self._share),
        )

    def _measure(self, aim: LinkTargets, dt_s: float) -> None:
        """Estimate the speeds of the feet, and let the floor follow one that stands still: tracking drifts."""
        if self._before is not None:
            speed = np.linalg.norm(aim.steps - self._before, axis=1) / dt_s
            share = 1.0 - np.exp(-dt_s / self._rules.speed_s)
            known = np.where(np.isfinite(self._speed), self._speed, speed)
            self._speed = known + (speed - known) * share
        self._before = aim.steps
        lower = int(aim.soles.argmin())
        if self._speed[lower] < self._rules.slow_mps / 2:
            self._floor_m += (float(aim.soles[lower]) - self._floor_m) * min(dt_s / self._rules.floor_s, 1.0)

    def _judge(self, heights: Floats, ankles: Floats) -> None:
        rules = self._rules
        # Before there is a speed, a foot that is low is taken to carry: an operator begins standing.
        slow = (self._speed < rules.slow_mps) | ~np.isfinite(self._speed)
        comes = ~self.carries & (heights < rules.low_m) & slow
        left = np.linalg.norm((ankles - self._held)[:, :2], axis=1) > rules.let_go_m
        fast = np.isfinite(self._speed) & (self._speed > rules.fast_mps)
        goes = self.carries & ((heights > rules.high_m) | fast | left)
        if comes.any():
            self._held[comes, :2] = ankles[comes, :2]
            self._held[comes, 2] = SOLE_DEPTH_M
        self.carries = (self.carries | comes) & ~goes
