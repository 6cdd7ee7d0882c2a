"""Where and when feet are put down: a path of the body from the wished velocities, and steps along it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adapters.motions.builtin.body import STANDING_FEET
from adapters.motions.builtin.plan import WalkPlan
from adapters.motions.builtin.profiles import FPS, rise
from station.protocols import Floats

_CLEAR_OF_EACH_OTHER_M = 0.15  # between the two ankles, sideways; the feet are 7 cm wide
_STANDING_WIDTH_M = float(STANDING_FEET[0, 1] - STANDING_FEET[1, 1])


@dataclass(frozen=True, slots=True)
class Step:
    """One foot going to a new place.

    Attributes:
        side: 0 left, 1 right.
        lift_s, land_s: When it leaves and reaches the floor [s].
        place: x, y [m] and heading [rad] of the foot.
        plan: What asked for it.
    """

    side: int
    lift_s: float
    land_s: float
    place: Floats
    plan: WalkPlan


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Where the body wishes to be: x, y [m] and heading [rad] at times, shape (n, 3)."""

    time_s: Floats
    place: Floats
    end_s: float

    def at(self, time_s: float | Floats) -> Floats:
        """Return the place at times of shape (...), clamped to the ends, shape (..., 3)."""
        return np.stack([np.interp(time_s, self.time_s, column) for column in self.place.T], axis=-1)


def plan_path(plans: Sequence[WalkPlan], start_s: float) -> Path:
    """Integrate the velocities of plans, each smoothly after the other, from the origin."""
    begins = start_s + np.cumsum([0.0, *(plan.duration_s for plan in plans)])
    time_s = np.arange(round((begins[-1] + 0.1) * 4 * FPS)) / (4 * FPS)
    velocity, before = np.zeros((len(time_s), 3)), np.zeros(3)
    for plan, begin_s in zip(plans, begins, strict=False):
        wish = np.array([plan.velocity_x, plan.velocity_y, plan.yaw_rate])
        velocity += rise(time_s, begin_s, begin_s + plan.ramp_s)[:, None] * (wish - before)
        before = wish
    velocity -= rise(time_s, begins[-1] - plans[-1].ramp_s, begins[-1])[:, None] * before
    yaw = _integral(velocity[:, 2])
    x, y = velocity[:, 0], velocity[:, 1]
    moved = (x * np.cos(yaw) - y * np.sin(yaw), x * np.sin(yaw) + y * np.cos(yaw))
    return Path(time_s, np.stack([_integral(moved[0]), _integral(moved[1]), yaw], axis=1), float(begins[-1]))


def plan_steps(plans: Sequence[WalkPlan], path: Path, start_s: float) -> list[Step]:
    """Place steps along a path until both feet stand under its end."""
    steps: list[Step] = []
    stands = [foothold(np.zeros(3), side, _STANDING_WIDTH_M) for side in (0, 1)]
    side, lift_s, arrived = plans[0].first_side, start_s, 0
    while arrived < 2:
        plan = _plan_at(plans, lift_s - start_s)
        land_s = lift_s + plan.step_s * (1.0 - plan.double_support)
        passed_s = land_s + plan.step_s * (1.0 + plan.double_support) / 2.0  # when the body is above this foot
        is_last = passed_s >= path.end_s
        place = foothold(path.at(passed_s), side, _STANDING_WIDTH_M if is_last else plan.width)
        stands[side] = _apart(place, stands[1 - side], side)
        steps.append(Step(side, lift_s, land_s, stands[side], plan))
        arrived = arrived + 1 if is_last else 0
        side, lift_s = 1 - side, lift_s + plan.step_s
    return steps


def foothold(body: Floats, side: int, width: float) -> Floats:
    """Return x, y and heading of a foot below a body at x, y and heading."""
    x, y = STANDING_FEET[side, 0], (0.5 - side) * width
    cosine, sine = np.cos(body[2]), np.sin(body[2])
    return np.array([body[0] + cosine * x - sine * y, body[1] + sine * x + cosine * y, body[2]])


def _apart(place: Floats, other: Floats, side: int) -> Floats:
    """Move a foothold sideways until it is clear of the other foot."""
    heading = (place[2] + other[2]) / 2.0
    outward = (1 - 2 * side) * np.array([-np.sin(heading), np.cos(heading)])
    missing = _CLEAR_OF_EACH_OTHER_M - float((place[:2] - other[:2]) @ outward)
    return np.asarray(place + np.append(max(missing, 0.0) * outward, 0.0))


def _plan_at(plans: Sequence[WalkPlan], elapsed_s: float) -> WalkPlan:
    for plan in plans:
        if elapsed_s < plan.duration_s:
            return plan
        elapsed_s -= plan.duration_s
    return plans[-1]


def _integral(rate: Floats) -> Floats:
    """Integrate samples of the fine time grid, from zero."""
    return np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / (8 * FPS))])
