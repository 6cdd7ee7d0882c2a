"""Walking, turning and stepping in every direction, from a few parameters.

Steps are placed first, where the body will be when it passes over them. The weight (ZMP) goes from foot to foot; the
centre of mass follows as an inverted pendulum must, looking ahead. Soles stay level and stance feet where they are;
the legs follow by inverse kinematics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adapters.motions.builtin import legs
from adapters.motions.builtin.body import (
    STANDING_COM,
    STANDING_FEET,
    STANDING_HEIGHT_M,
    STANDING_Q,
    Pose,
    first_beyond_range,
    from_roll_pitch_yaw,
    turned,
)
from adapters.motions.builtin.footsteps import Path, Step, plan_path, plan_steps
from adapters.motions.builtin.plan import SHORTEST_STEP_S, WalkPlan
from adapters.motions.builtin.profiles import below, bump, rise, sway_under, times
from adapters.motions.raw import RawMotion
from adapters.robots.g1 import kinematics
from adapters.robots.g1.joints import G1_29, LEGS
from station.errors import ConfigError, UsageError
from station.protocols import Floats

STAND_S = 0.6
"""Standing before and after a walk [s]; the weight begins to move in it."""

SHIFT_S = 0.4
"""From standing on both feet to the first lift, and back after the last footfall [s]."""

# How the rest of the body goes along. Found with TWIST2 in the loop: with the roll it follows a walk backwards at
# 0.3 m/s by 94 % of its length, without it by 86 %, and no worse in other directions.
PELVIS_YAW = 0.25  # rad per metre between the feet: the hip goes with the leg that swings forward
PELVIS_ROLL = 1.5  # rad per metre that the weight is beside the middle: the hip above the swinging leg drops
WAIST_YAW = -1.5  # of the pelvis' yaw: the shoulders turn against the hips
ARM_SWING = 0.7  # rad at the shoulder per metre between the feet, against the leg of that side
ELBOW_SWING = 0.25  # rad per metre
LIFT_SWING = 2.0  # metres between the feet that a metre between their heights counts as: arms go along in a march

_STRAIGHTEST_KNEE = 0.25  # rad
_DIP_S = 0.16  # the pelvis gives way this long around the instant in which a leg is longest
_LOWER_S = 0.8  # from one height of the pelvis to another
_SHORTER = tuple(0.92**power for power in range(9))  # of the wished time of a step, until all joints are in range
_UPPER = G1_29[len(LEGS) :]


def gait(*plans: WalkPlan, name: str = "gait") -> RawMotion:
    """Walk from standing through plans and back to standing.

    Args:
        plans: One velocity after the other, without a stop between them; at least one.
        name: Of the motion.

    Raises:
        UsageError: no plan.
        ConfigError: the legs cannot do it, however short the steps.
    """
    if not plans:
        raise UsageError(f"{name}: no plan to walk; give at least one WalkPlan")
    for shorter in _SHORTER:
        pose = _walk([replace(plan, step_s=max(plan.step_s * shorter, SHORTEST_STEP_S)) for plan in plans])
        q = pose.joints()
        if first_beyond_range(q) is None:
            return pose.motion(name, q)
    raise ConfigError(f"{name}: the ankles reach no further however short the steps; ask for lower velocities")


def _walk(plans: Sequence[WalkPlan]) -> Pose:
    start_s = STAND_S + SHIFT_S
    path = plan_path(plans, start_s)
    steps = plan_steps(plans, path, start_s)
    return _Walk(times(steps[-1].land_s + SHIFT_S + STAND_S), path, steps).pose()


@dataclass(frozen=True, slots=True, eq=False)
class _Walk:
    """Steps along a path, frame by frame."""

    time_s: Floats
    path: Path
    steps: Sequence[Step]

    def pose(self) -> Pose:
        feet, feet_yaw = self._feet()
        yaw = self.path.at(self.time_s)[:, 2]
        com = self._centre_of_mass()
        ahead = turned(feet[0, :, :2] - feet[1, :, :2], -yaw)[:, 0]  # the left foot before the right one
        aside = turned(com - feet[:, :, :2].mean(axis=0), -yaw)[:, 1]
        aside -= STANDING_COM[1]
        swing, roll = -PELVIS_YAW * ahead, PELVIS_ROLL * aside
        hips_xy = com - turned(STANDING_COM[:2], yaw)
        quat = from_roll_pitch_yaw(np.column_stack([roll, np.zeros_like(roll), yaw + swing]))
        limit = legs.highest(kinematics.matrix(quat), hips_xy, feet, _STRAIGHTEST_KNEE)
        pelvis = np.column_stack([hips_xy, below(self._through("height", STANDING_HEIGHT_M), limit, _DIP_S)])
        ahead += LIFT_SWING * (feet[0, :, 2] - feet[1, :, 2])
        return Pose(pelvis, quat, feet, feet_yaw, self._upper(ahead, swing, roll))

    def _feet(self) -> tuple[Floats, Floats]:
        """Positions (2, n, 3) and headings (2, n) of the feet."""
        position = np.repeat(STANDING_FEET[:, None], len(self.time_s), axis=1)
        yaw = np.zeros((2, len(self.time_s)))
        now = [np.array([*foot[:2], 0.0]) for foot in STANDING_FEET]
        for step in self.steps:
            moved = rise(self.time_s, step.lift_s, step.land_s)[:, None] * (step.place - now[step.side])
            position[step.side, :, :2] += moved[:, :2]
            position[step.side, :, 2] += step.plan.clearance * bump(self.time_s, step.lift_s, step.land_s)
            yaw[step.side] += moved[:, 2]
            now[step.side] = step.place
        return position, yaw

    def _weight(self) -> Floats:
        """Where the floor pushes (the ZMP), shape (n, 2) [m]: on the standing foot, and over to the next."""
        now = [np.array([*foot[:2], 0.0]) for foot in STANDING_FEET]
        at, end = _under(self.path.at(0.0)), _under(self.path.at(self.time_s[-1]))
        points = np.repeat(at[None], len(self.time_s), axis=0)
        landed_s = self.steps[0].lift_s - SHIFT_S
        for step in self.steps:
            on = _pressed(now[1 - step.side])
            points += rise(self.time_s, landed_s, step.lift_s)[:, None] * (on - at)
            at, landed_s, now[step.side] = on, step.land_s, step.place
        points += rise(self.time_s, landed_s, landed_s + SHIFT_S)[:, None] * (end - at)
        return points

    def _centre_of_mass(self) -> Floats:
        """Of the whole body, in the plane, shape (n, 2) [m]; at rest at both ends."""
        weight, end_s = self._weight(), float(self.time_s[-1])
        com = sway_under(weight, float(STANDING_COM[2]))
        # The pendulum begins to lean before the first and ends after the last frame: a millimetre is cut off there.
        com += (1.0 - rise(self.time_s, 0.0, STAND_S))[:, None] * (weight[0] - com)
        com += rise(self.time_s, end_s - STAND_S, end_s)[:, None] * (weight[-1] - com)
        return com

    def _through(self, wish: str, standing: float) -> Floats:
        """Return a number of the plans, each smoothly after the other, from standing and back, shape (n,)."""
        values, before, begin_s, plan = np.full(len(self.time_s), standing), standing, 0.0, None
        for step in self.steps:
            if step.plan is not plan:
                plan, value = step.plan, float(getattr(step.plan, wish))
                begin_s = step.lift_s - SHIFT_S
                values += rise(self.time_s, begin_s, begin_s + _LOWER_S) * (value - before)
                before = value
        begin_s = self.steps[-1].land_s + SHIFT_S - _LOWER_S
        values += rise(self.time_s, begin_s, begin_s + _LOWER_S) * (standing - before)
        return values

    def _upper(self, ahead: Floats, swing: Floats, roll: Floats) -> Floats:
        """Waist and arms, shape (n, 17) [rad]."""
        upper = np.repeat(STANDING_Q[None, len(LEGS) :], len(self.time_s), axis=0)
        reach = ahead * self._through("arm_swing", 0.0)
        for side, sign in (("left", 1.0), ("right", -1.0)):
            upper[:, _UPPER.index(f"{side}_shoulder_pitch")] += sign * ARM_SWING * reach
            upper[:, _UPPER.index(f"{side}_elbow")] += sign * ELBOW_SWING * reach
        upper[:, _UPPER.index("waist_yaw")] += WAIST_YAW * swing
        upper[:, _UPPER.index("waist_roll")] -= roll
        return upper


def _pressed(foot: Floats) -> Floats:
    """The point of a sole that carries, for a foot at x, y and heading; as far forward as when standing."""
    return np.asarray(foot[:2] + turned(np.array([STANDING_COM[0] - STANDING_FEET[0, 0], 0.0]), foot[2]))


def _under(body: Floats) -> Floats:
    """The point below the centre of mass of a body that stands at x, y and heading."""
    return np.asarray(body[:2] + turned(STANDING_COM[:2], body[2]))
