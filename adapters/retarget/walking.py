"""Walking by sticks: velocities and a height become a reference of the whole body, tick by tick.

As `adapters.motions.builtin.gait`, but with an end that is not known: the steps to come are planned anew in every tick
from the velocity of that moment, the centre of mass goes where a pendulum that looks ahead to them goes, the legs
follow by inverse kinematics. Feet that carry stand still. Pure: time comes as arguments.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from adapters.motions.builtin import legs
from adapters.motions.builtin.body import (
    STANDING_COM,
    STANDING_FEET,
    STANDING_HEIGHT_M,
    STANDING_Q,
    Pose,
    from_roll_pitch_yaw,
    standing_feet,
    turned,
)
from adapters.motions.builtin.gait import ARM_SWING, ELBOW_SWING, LIFT_SWING, PELVIS_ROLL, PELVIS_YAW, WAIST_YAW
from adapters.retarget.steps import CARRIES_S, Steps, is_moving
from adapters.robots.g1 import joints as g1
from adapters.robots.g1 import kinematics
from adapters.robots.g1.joints import G1_29, LEGS
from station import rotations
from station.protocols import Floats, Reference

LOWEST_M, HIGHEST_M = 0.5, STANDING_HEIGHT_M
"""Range of the pelvis' height [m]; walking keeps above `LOWEST_WALK_M`."""

LOWEST_WALK_M = 0.66

FASTEST = np.array([0.7, 0.3, 0.8])
"""Greatest velocity forward, to the side [m/s] and turning [rad/s]."""

FASTEST_BACK = 0.4
"""Greatest velocity backwards [m/s]."""

ACCELERATION = np.array([0.8, 0.5, 1.6])
"""Greatest change of it [m/s^2, m/s^2, rad/s^2]."""

_WALK_HEIGHT_M = 0.775
_HEIGHT_RATE, _HEIGHT_ACCELERATION, _HEIGHT_TIME_S = 0.3, 1.0, 0.1  # m/s, m/s^2, and how it settles
_CLEARANCE_M = 0.06
_GIVES_WAY_M = 0.008  # nearer to a limit the pelvis gives way
_STRAIGHTEST_KNEE = 0.25  # rad
_LEAN = 0.9  # rad per metre that the pelvis is lower than `_UPRIGHT_M`: the ankles would reach their end otherwise
_UPRIGHT_M = 0.74
_AHEAD_S = np.arange(0.0125, 1.4, 0.025)  # how far the pendulum looks
_OMEGA = math.sqrt(9.81 / STANDING_COM[2])
_LOOKS = np.exp(-_OMEGA * _AHEAD_S) / np.exp(-_OMEGA * _AHEAD_S).sum()
_UPPER = G1_29[len(LEGS) :]
_LOWEST_Q, _HIGHEST_Q = g1.lower(G1_29), g1.upper(G1_29)
_SLIPS_S = 0.35  # in a curve policies are carried outward, by so much of speed times turning; TWIST2's and ours alike
_FOLLOWS, _LEANS_S, _FARTHEST_M = 0.87, 0.3, 0.1  # part of a shift of the pelvis that the weight makes; how it leans
_CENTRED_M, _STEADY_MPS = 1e-3, 1e-3  # a body that stands
_SPARE_M = 0.08  # the body is not exactly where it wishes to be when a foot lands below it
_REACHES = np.linspace(0.0, 0.4, 41)
_HIGHEST = legs.highest(
    np.tile(np.eye(3), (len(_REACHES), 1, 1)),
    np.outer(_REACHES, (1.0, 0.0)),
    np.repeat(STANDING_FEET[:, None], len(_REACHES), axis=1),
    _STRAIGHTEST_KNEE,
)  # of the pelvis, with a foot so far before or behind the hip [m]


@dataclass(frozen=True, slots=True)
class VelocityCommand:
    """What the sticks ask for; more than the legs can is cut off.

    Attributes:
        velocity_x, velocity_y: Of the body, forward and to the left [m/s].
        yaw_rate: To the left [rad/s].
        height: Of the pelvis above the floor [m].
    """

    velocity_x: float = 0.0
    velocity_y: float = 0.0
    yaw_rate: float = 0.0
    height: float = STANDING_HEIGHT_M


class Walker:
    """A body on legs that goes where it is told, from standing and back to standing."""

    def __init__(self) -> None:
        self._steps = Steps()
        self._velocity = np.zeros(3)
        self._com = STANDING_COM[:2].copy()
        self._height, self._height_rate = STANDING_HEIGHT_M, 0.0
        self._legs = STANDING_Q[: len(LEGS)].copy()
        self._heights, self._shifts = _squats()
        self._shift = np.zeros(2)  # of the weight, by waist and arms, forward and to the left [m]
        self._asked: dict[str, float] = {}
        self._reference = self._referred(*self._pose())

    @property
    def velocity(self) -> Floats:
        """Velocity of the body now: forward, to the left [m/s], turning left [rad/s]."""
        return self._velocity.copy()

    @property
    def is_standing(self) -> bool:
        """Whether both feet stand and nothing is on its way."""
        is_centred = float(np.abs(self._com - self._steps.weight(_AHEAD_S[:1])[0]).max()) < _CENTRED_M
        return self._steps.phase == "standing" and is_centred and abs(self._height_rate) < _STEADY_MPS

    @property
    def reference(self) -> Reference:
        """What is asked of the whole body now; joints in the order of `adapters.robots.g1.joints.G1_29`."""
        return self._reference

    def step(self, dt_s: float, wish: VelocityCommand, upper: Mapping[str, float] | None = None) -> Reference:
        """Go on for a period.

        Args:
            dt_s: The period [s].
            wish: For the legs.
            upper: Joints of waist and arms by name [rad]; the waist's are added to what walking asks of it, those of
                the arms replace their swing. The pelvis goes where their weight is balanced. None lets the arms swing.

        Returns:
            What is asked of the whole body.
        """
        self._lean(dt_s, upper)
        wanted = _possible(wish)
        goal = wanted if self._steps.may_move else np.zeros(3)
        self._velocity = self._velocity + np.clip(goal - self._velocity, -ACCELERATION * dt_s, ACCELERATION * dt_s)
        self._steps.advance(dt_s, self._velocity, wanted)
        self._com += (1.0 - math.exp(-_OMEGA * dt_s)) * (_LOOKS @ self._steps.weight(_AHEAD_S) - self._com)
        self._rise(dt_s, wish.height)
        self._reference = self._referred(*self._pose(), before=self._reference, dt_s=dt_s)
        return self._reference

    def _lean(self, dt_s: float, upper: Mapping[str, float] | None) -> None:
        """Set where waist and arms shall be, and let the pelvis follow the weight that they move."""
        self._asked = dict(upper or {})
        shift = np.zeros(2)
        if upper is not None:
            q = STANDING_Q.copy()
            q[[G1_29.index(name) for name in upper]] = list(upper.values())
            com = kinematics.forward(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]), q[None]).centre_of_mass()[0]
            shift = np.clip((com - STANDING_COM)[:2] / _FOLLOWS, -_FARTHEST_M, _FARTHEST_M)
        self._shift += (1.0 - math.exp(-dt_s / _LEANS_S)) * (shift - self._shift)

    def _rise(self, dt_s: float, height: float) -> None:
        """Go towards a height, no higher than the strides of this velocity allow, without a jerk."""
        limit = self._highest()
        is_walking = self._steps.phase != "standing"
        goal = min(max(height, LOWEST_WALK_M if is_walking else LOWEST_M), limit)
        missing = goal - self._height
        braking = math.sqrt(_HEIGHT_ACCELERATION * abs(missing))  # what it can stop from in time, with room to spare
        rate = math.copysign(min(braking, _HEIGHT_RATE, abs(missing) / _HEIGHT_TIME_S), missing)
        change = _HEIGHT_ACCELERATION * dt_s
        self._height_rate += min(max(rate - self._height_rate, -change), change)
        self._height += self._height_rate * dt_s

    def _highest(self) -> float:
        """The pelvis' greatest height at which no leg is too long at the ends of a stride."""
        if self._steps.phase == "standing":
            return HIGHEST_M
        reach = math.hypot(*self._velocity[:2]) * CARRIES_S / 2.0 + _SPARE_M
        return min(float(np.interp(reach, _REACHES, _HIGHEST)), _WALK_HEIGHT_M)

    def _pose(self) -> tuple[Pose, Floats]:
        feet, feet_yaw = self._steps.ankles(_CLEARANCE_M)
        yaw = self._steps.place[2]
        ahead = float(turned(feet[0, :2] - feet[1, :2], -yaw)[0])  # the left foot before the right one
        aside = float(turned(self._com - feet[:, :2].mean(axis=0), -yaw)[1] - STANDING_COM[1])
        swing, roll, pitch = -PELVIS_YAW * ahead, PELVIS_ROLL * aside, _LEAN * max(_UPRIGHT_M - self._height, 0.0)
        squat = np.array([np.interp(self._height, self._heights, self._shifts), 0.0])
        hips_xy = self._com + turned(squat - self._shift - STANDING_COM[:2], yaw)
        quat = from_roll_pitch_yaw(np.array([[roll, pitch, yaw + swing]]))
        ahead += LIFT_SWING * float(feet[0, 2] - feet[1, 2])
        limit = legs.highest(kinematics.matrix(quat), hips_xy[None], feet[:, None], _STRAIGHTEST_KNEE)
        pelvis = np.array([[*hips_xy, _below(self._height, float(limit[0]))]])
        pose = Pose(pelvis, quat, feet[:, None], feet_yaw[:, None], self._upper(ahead, swing, roll)[None])
        q = pose.joints(np.append(self._legs, pose.upper)[None])[0]
        self._legs = q[: len(LEGS)]
        return pose, np.clip(q, _LOWEST_Q, _HIGHEST_Q)  # an ankle that would need more lets its sole tilt

    def _upper(self, ahead: float, swing: float, roll: float) -> Floats:
        """Waist and arms, shape (17,) [rad]: shoulders turn against the hips, arms swing against the legs."""
        upper = STANDING_Q[len(LEGS) :].copy()
        for side, sign in (("left", 1.0), ("right", -1.0)):
            upper[_UPPER.index(f"{side}_shoulder_pitch")] += sign * ARM_SWING * ahead
            upper[_UPPER.index(f"{side}_elbow")] += sign * ELBOW_SWING * ahead
        for name, value in self._asked.items():
            upper[_UPPER.index(name)] = value
        upper[_UPPER.index("waist_yaw")] += WAIST_YAW * swing
        upper[_UPPER.index("waist_roll")] -= roll
        return upper

    def _referred(self, pose: Pose, q: Floats, before: Reference | None = None, dt_s: float = 0.0) -> Reference:
        position, quat = pose.pelvis[0], pose.pelvis_quat[0]
        linear = angular = np.zeros(3)
        if before is not None and dt_s > 0.0:
            linear = rotations.rotate_inverse(quat, (position - before.root_pos) / dt_s)
            turn = rotations.multiply(rotations.inverse(before.root_quat_wxyz), quat)
            angular = rotations.rotation_vector(turn) / dt_s
        return Reference(position, quat, linear, angular, q)


def _possible(wish: VelocityCommand) -> Floats:
    """The velocity of a wish, within what the legs can; in a curve so far inward that the robot does not leave it."""
    lowest = np.array((-FASTEST_BACK, *-FASTEST[1:]))
    velocity = np.clip((wish.velocity_x, wish.velocity_y, wish.yaw_rate), lowest, FASTEST)
    velocity[1] += _SLIPS_S * velocity[0] * velocity[2]
    velocity = np.clip(velocity, lowest, FASTEST)
    return velocity if is_moving(velocity) else np.zeros(3)


def _below(wish: float, limit: float) -> float:
    """Return a wish where it is well below a limit, and a smooth way to the limit where it is not [m]."""
    room = min(max(limit - wish, -_GIVES_WAY_M), _GIVES_WAY_M)
    return min(wish, limit) if abs(room) == _GIVES_WAY_M else wish - (_GIVES_WAY_M - room) ** 2 / (4.0 * _GIVES_WAY_M)


@cache
def _squats() -> tuple[Floats, Floats]:
    """How far the pelvis is behind where it stands [m] at heights [m], for the weight to stay above the feet."""
    heights = np.linspace(LOWEST_M, HIGHEST_M, 12)
    feet, feet_yaw = standing_feet(len(heights))
    pitch = _LEAN * np.maximum(_UPRIGHT_M - heights, 0.0)
    quat = from_roll_pitch_yaw(np.column_stack([np.zeros_like(pitch), pitch, np.zeros_like(pitch)]))
    pelvis = np.column_stack([np.zeros((len(heights), 2)), heights])
    upper = np.repeat(STANDING_Q[None, len(LEGS) :], len(heights), axis=0)
    weight = np.repeat(STANDING_COM[None, :2], len(heights), axis=0)
    pose, _ = Pose(pelvis, quat, feet, feet_yaw, upper).balanced(weight)
    return heights, pose.pelvis[:, 0]
