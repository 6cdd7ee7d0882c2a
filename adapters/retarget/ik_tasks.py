"""What the inverse kinematics asks for, in the terms of `mink`: where bones point, where links are, what is too far."""

from __future__ import annotations

from dataclasses import dataclass

import mink
import mujoco
import numpy as np

from adapters.motions.builtin.body import STANDING_HEIGHT_M, STANDING_Q
from adapters.retarget.bone_frames import directed, to_quats
from adapters.retarget.human import G1_SIZED, SIDES
from adapters.retarget.scaling import LinkTargets
from station.protocols import Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """What matters how much; costs of places are per metre, of directions and orientations per radian.

    Attributes:
        pelvis, pelvis_turn, chest_turn: Place and orientations of the trunk.
        foot, foot_turn: Of the ankle_roll links; the greatest, because feet that slide are what falls.
        thigh, upper_arm, forearm: Directions of bones, as places of their lower ends.
        hand_turn: Orientations of the hands.
        posture: Towards standing, for what nothing else decides: twists of straight arms.
        freeing: The same, of an arm that is led back (`arm_rescue`).
        damping: Against motion for its own sake.
    """

    pelvis: float = 10.0
    pelvis_turn: float = 6.0
    chest_turn: float = 4.0
    foot: float = 40.0
    foot_turn: float = 6.0
    thigh: float = 4.0
    upper_arm: float = 8.0
    forearm: float = 8.0
    hand_turn: float = 0.8
    posture: float = 0.02
    freeing: float = 2.0
    damping: float = 1e-4


_HIP_ON_AXIS = np.array([0.0, G1_SIZED.hip_half_width - 0.064452, 0.0])  # in the frame of hip_pitch, left


ARMS = np.array([range(15, 22), range(22, 29)])
"""Places of the joints of each arm in `adapters.robots.g1.joints.G1_29`, shape (2, 7)."""


class BoneTask(mink.Task):
    """A bone points somewhere: the place of one link, seen from another, in the world's axes.

    Args:
        model: MuJoCo model.
        upper, lower: Names of the links; both at their origins, the upper one `shift` away from it.
        cost: Per metre.
        shift: In the frame of the upper link, shape (3,) [m].
    """

    def __init__(self, model: mujoco.MjModel, upper: str, lower: str, cost: float, shift: Floats | None = None) -> None:
        super().__init__(cost=np.full(3, cost))
        self._upper, self._lower = model.body(upper).id, model.body(lower).id
        self._shift = np.zeros(3) if shift is None else shift
        self._jacobians = np.zeros((2, 3, model.nv))
        self.vector = np.zeros(3)
        """Where the lower link shall be, seen from the upper one, shape (3,) [m]."""

    def direction(self, configuration: mink.Configuration) -> Floats:
        """Return where the bone points, a unit vector, shape (3,)."""
        return directed(configuration.data.xpos[self._lower] - self._start(configuration.data))

    def compute_error(self, configuration: mink.Configuration) -> Floats:
        """Return how far the lower link is from where it shall be, shape (3,) [m]."""
        data = configuration.data
        return np.asarray(data.xpos[self._lower] - self._start(data) - self.vector)

    def compute_jacobian(self, configuration: mink.Configuration) -> Floats:
        """Return the change of that error with the joints, shape (3, nv)."""
        model, data = configuration.model, configuration.data
        upper, lower = self._jacobians
        mujoco.mj_jac(model, data, upper, None, self._start(data), self._upper)
        mujoco.mj_jac(model, data, lower, None, data.xpos[self._lower], self._lower)
        return np.asarray(lower - upper)

    def _start(self, data: mujoco.MjData) -> Floats:
        return np.asarray(data.xpos[self._upper] + data.xmat[self._upper].reshape(3, 3) @ self._shift)


class Box(mink.Limit):
    """Keeps every degree of freedom within its range and within reach of where the frame began.

    One bound per degree of freedom and side, where `mink`'s own two limits would give two; and it holds over all
    rounds of a frame together.

    Args:
        model: MuJoCo model: a free root, then hinges.
        lower, upper: Ranges of the hinges, shape (nv - 6,) [rad].
    """

    def __init__(self, model: mujoco.MjModel, lower: Floats, upper: Floats) -> None:
        self._model = model
        self._lower, self._upper = lower, upper
        self._matrix = np.vstack([np.eye(model.nv), -np.eye(model.nv)])
        self._begun, self._reach = np.zeros(model.nq), np.zeros(model.nv)
        self._done = np.zeros(model.nv)

    def begin(self, q: Floats, reach: Floats) -> None:
        """Begin a frame at a configuration, shape (nq,); `reach` is how far each may go, shape (nv,)."""
        self._begun, self._reach = q.copy(), reach
        self._least = np.maximum(self._lower, self._begun[7:] - reach[6:])
        self._most = np.minimum(self._upper, self._begun[7:] + reach[6:])

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> mink.Constraint:
        """Return the bounds on the next step."""
        del dt  # what may be done in a frame is known already
        q = configuration.q
        mujoco.mj_differentiatePos(self._model, self._done, 1.0, self._begun, q)
        upper, lower = self._reach - self._done, self._reach + self._done
        upper[6:], lower[6:] = self._most - q[7:], q[7:] - self._least
        # A bound that rounding has put a hair outside would leave no solution at all.
        return mink.Constraint(self._matrix, np.maximum(np.concatenate([upper, lower]), 0.0))

    def inside(self, q: Floats) -> Floats:
        """Return a configuration with its hinges within the bounds to the last bit: solvers have tolerances."""
        q[7:] = np.clip(q[7:], self._least, self._most)
        return q


_PUSHED_M = 0.002  # per round, of shapes that have come too near all the same: a round is straight, arms are not


class Clearance(mink.CollisionAvoidanceLimit):
    """Keeps forearms and hands clear of trunk, thighs and each other, as `mink` does; by the shapes that touch.

    A pair is kept apart at its nearest points; two forearms that lie on each other lengthwise may overlap by 2 cm.

    Args:
        model: MuJoCo model.
        clear_m: What is left between two shapes at least [m].
        watch_m: From here on they are watched [m]; more than an arm goes in one round.
    """

    def __init__(self, model: mujoco.MjModel, clear_m: float = 0.005, watch_m: float = 0.08) -> None:
        arms = {side: _touching(model, f"{side}_elbow_link", f"{side}_wrist_yaw_link") for side in SIDES}
        thighs = [f"{side}_hip_{link}_link" for side in SIDES for link in ("roll", "yaw")]
        trunk = _touching(model, "pelvis", "torso_link", *thighs)
        super().__init__(
            model,
            geom_pairs=[(arms["left"] + arms["right"], trunk), (arms["left"], arms["right"])],
            minimum_distance_from_collisions=clear_m,
            collision_detection_distance=watch_m,
            bound_relaxation=-_PUSHED_M,
        )

    def compute_qp_inequalities(self, configuration: mink.Configuration, dt: float) -> mink.Constraint:
        """Return the bounds on the next step, of those pairs alone that are near each other."""
        every = super().compute_qp_inequalities(configuration, dt)
        if every.G is None or every.h is None:
            return every
        near = np.isfinite(every.h)
        return mink.Constraint(every.G[near], every.h[near]) if near.any() else mink.Constraint()


def _touching(model: mujoco.MjModel, *links: str) -> list[int]:
    """Shapes of links that touch others, not those that are only seen."""
    bodies = {model.body(link).id for link in links}
    touches = (model.geom_contype | model.geom_conaffinity) != 0
    return [geom for geom in range(model.ngeom) if touches[geom] and model.geom_bodyid[geom] in bodies]


class Tasks:
    """All tasks of a body, and how an `LinkTargets` sets them; made by `tasks_for`."""

    def __init__(self, model: mujoco.MjModel, weights: Weights) -> None:
        def place(link: str, position: float, orientation: float) -> mink.FrameTask:
            return mink.FrameTask(link, "body", position_cost=position, orientation_cost=orientation)

        def bones(upper: str, lower: str, cost: float) -> list[BoneTask]:
            return [BoneTask(model, f"{side}_{upper}_link", f"{side}_{lower}_link", cost) for side in SIDES]

        self.pelvis = place("pelvis", weights.pelvis, weights.pelvis_turn)
        self.chest = place("torso_link", 0.0, weights.chest_turn)
        self.feet = [place(f"{side}_ankle_roll_link", weights.foot, weights.foot_turn) for side in SIDES]
        self.hands = [place(f"{side}_wrist_yaw_link", 0.0, weights.hand_turn) for side in SIDES]
        self.thighs = [
            BoneTask(model, f"{side}_hip_pitch_link", f"{side}_knee_link", weights.thigh, sign * _HIP_ON_AXIS)
            for side, sign in zip(SIDES, (1, -1), strict=True)
        ]
        self.upper_arms = bones("shoulder_roll", "elbow", weights.upper_arm)
        self.forearms = bones("elbow", "wrist_pitch", weights.forearm)
        self.posture = mink.PostureTask(model, cost=np.full(model.nv, weights.posture))
        self.posture.set_target(np.concatenate([[0.0, 0.0, STANDING_HEIGHT_M, 1.0, 0.0, 0.0, 0.0], STANDING_Q]))
        self._weights = weights
        self.all = [
            self.pelvis, self.chest, *self.feet, *self.hands,
            *self.thighs, *self.upper_arms, *self.forearms, self.posture,
        ]  # fmt: skip

    def free(self, side: int, is_freed: bool) -> None:
        """Ask an arm for the standing pose and nothing else, or for what the aim says."""
        weights = self._weights
        self.upper_arms[side].cost[:] = 0.0 if is_freed else weights.upper_arm
        self.forearms[side].cost[:] = 0.0 if is_freed else weights.forearm
        self.hands[side].set_orientation_cost(0.0 if is_freed else weights.hand_turn)
        self.posture.cost[6 + ARMS[side]] = weights.freeing if is_freed else weights.posture

    def aim_at(self, aim: LinkTargets) -> None:
        """Set every target."""
        frames = (self.pelvis, self.chest, *self.feet, *self.hands)
        turns = to_quats(np.concatenate([aim.pelvis_turn[None], aim.chest_turn[None], aim.feet_turn, aim.hands_turn]))
        places = (aim.pelvis, _ANYWHERE, *aim.ankles, _ANYWHERE, _ANYWHERE)
        for task, turn, place in zip(frames, turns, places, strict=True):
            task.set_target(mink.SE3(np.concatenate([turn, place])))
        for side in range(2):
            self.thighs[side].vector = aim.thighs[side] * G1_SIZED.thigh
            self.upper_arms[side].vector = aim.upper_arms[side] * G1_SIZED.upper_arm
            self.forearms[side].vector = aim.forearms[side] * G1_SIZED.forearm


def tasks_for(model: mujoco.MjModel, weights: Weights) -> Tasks:
    """Return the tasks of a G1, weighted by `adapters.retarget.ik_tasks.Weights`."""
    return Tasks(model, weights)


_ANYWHERE = np.zeros(3)  # of tasks that cost nothing for a place
