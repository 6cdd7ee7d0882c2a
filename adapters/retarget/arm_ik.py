"""Both arms of a G1 by the poses of its palms: differential inverse kinematics by mink, one step per tick.

Everything is in the frame of the pelvis with the torso upright above it: the counter-movements of the waist in a walk
are not seen here. Pure: time comes as arguments.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from adapters.commands.twist2 import FORMAT
from adapters.robots.g1 import joints as g1
from adapters.robots.g1.joints import G1_29, LEGS
from station import assets
from station.errors import StationError
from station.operator.sample import Pose, Side
from station.protocols import Floats

SIDES: tuple[Side, Side] = ("left", "right")

ARMS = G1_29[15:]
"""The 14 joints of both arms, left first."""

WAIST = G1_29[12:15]

FASTEST_RAD_S = 6.0
"""Greatest speed of a joint; their motors could do four times as much."""

MODEL = "builtin:g1.xml"

_REACH_M = 0.4465  # from the shoulder to the palm of an arm that is all but straight: 0.4486 m is the end
_NEAREST_M = 0.17  # a palm nearer to its shoulder folds the elbow to its end
_BEHIND_RAD, _ACROSS_RAD, _TWISTED_RAD = 0.5, 0.6, 1.8  # shoulders: see `_plausible`
_REST_S = 3.0  # in this time the elbows go where they hang at rest, as far as the palms let them
_POSITION, _ORIENTATION, _POSTURE, _STEADINESS = 10.0, 2.0, 0.15, 1.0  # what a metre, a radian, … counts
_GAP_M, _SEEN_M = 0.025, 0.1  # between arms, trunk and each other: kept, and looked for
_NEARS, _TICK_S = 0.2, 0.01  # part of what is left of a gap that may go in a tick; mink's own gain is per second


class ArmIk:
    """Arms that follow goals for their palms, within the ranges and speeds of their joints and clear of the body.

    Args:
        waist: Whether yaw, roll and pitch of the waist help.

    Raises:
        StationError: the extra ``retarget`` is not installed.
    """

    def __init__(self, *, waist: bool = False) -> None:
        self.joint_names = (*WAIST, *ARMS) if waist else ARMS
        self._mink = mink = _mink_library()
        model = _model(self.joint_names)
        self._order = [int(model.joint(f"{name}_joint").qposadr[0]) for name in self.joint_names]
        self._lower, self._upper = model.jnt_range[self._order].T.copy()
        self._fastest = np.minimum(g1.velocity(self.joint_names), FASTEST_RAD_S)
        self._configuration = mink.Configuration(model)
        self._palms = {
            side: mink.FrameTask(f"{side}_palm", "site", _POSITION, _ORIENTATION, lm_damping=0.01) for side in SIDES
        }
        self._posture = mink.PostureTask(model, cost=_POSTURE)
        self._inertia = mink.PostureTask(model, cost=_STEADINESS)  # towards where the joints would go by themselves
        self._limits = [
            mink.ConfigurationLimit(model, gain=0.5),
            mink.VelocityLimit(
                model, {f"{name}_joint": speed for name, speed in zip(self.joint_names, self._fastest, strict=True)}
            ),
            _clear_of_the_body(mink, model),
        ]
        self._rest = np.array(FORMAT.default[6:])[[G1_29.index(name) for name in self.joint_names]]
        self._towards = self._rest.copy()
        self.reset(self._rest)

    @property
    def q(self) -> Floats:
        """Joints now, in the order of `joint_names`, shape (n,) [rad]."""
        return np.asarray(self._configuration.q[self._order])

    @property
    def palms(self) -> dict[Side, Pose]:
        """Where the palms are now, in the frame of the pelvis."""
        return {side: self._pose(side) for side in SIDES}

    def reset(self, q: Floats) -> None:
        """Start from joints, in the order of `joint_names` [rad]; those out of range go to its end."""
        inside = np.clip(q, self._lower, self._upper)
        self._set(inside)
        self._speed = np.zeros(len(inside))
        self._goals = self.palms
        self._towards = inside.copy()

    def step(self, goals: Mapping[Side, Pose], dt_s: float) -> Floats:
        """Go towards goals for the palms for a period [s]; one without a goal keeps its last. Returns `q`."""
        if dt_s <= 0.0:
            return self.q
        self._goals |= goals
        for side, task in self._palms.items():
            task.set_target(_se3(self._mink, within_reach(self._goals[side], self._shoulder(side))))
        self._towards += (1.0 - math.exp(-dt_s / _REST_S)) * (self._rest - self._towards)
        self._posture.set_target(self._arranged(self._towards))
        before = self.q
        self._inertia.set_target(self._arranged(before + self._speed * dt_s))
        tasks = [*self._palms.values(), self._posture, self._inertia]
        try:
            velocity = self._mink.solve_ik(self._configuration, tasks, dt_s, solver="daqp", limits=self._limits)
        except self._mink.NoSolutionFound:
            velocity = np.zeros(len(before))  # to stand still is always a way; the next goal is another chance
        wanted = before + np.clip(velocity[self._order], -self._fastest, self._fastest) * dt_s
        self._set(np.clip(wanted, self._lower, self._upper))
        self._speed = (self.q - before) / dt_s
        return self.q

    def _set(self, q: Floats) -> None:
        self._configuration.update(self._arranged(q))

    def _arranged(self, q: Floats) -> Floats:
        arranged = np.empty(len(q))
        arranged[self._order] = q
        return arranged

    def _pose(self, side: Side) -> Pose:
        placed = self._configuration.get_transform_frame_to_world(f"{side}_palm", "site")
        return Pose(placed.translation(), placed.rotation().wxyz)

    def _shoulder(self, side: Side) -> Floats:
        return np.array(self._configuration.data.body(f"{side}_shoulder_roll_link").xpos)


def within_reach(goal: Pose, shoulder: Floats) -> Pose:
    """Return a goal as far from its shoulder as an arm can reach, on the line from there."""
    way = goal.position - shoulder
    distance = max(float(np.linalg.norm(way)), 1e-6)
    reached = min(max(distance, _NEAREST_M), _REACH_M)
    return goal if reached == distance else Pose(shoulder + way * (reached / distance), goal.quat_wxyz)


def _se3(mink: Any, pose: Pose) -> Any:
    return mink.SE3(np.concatenate([pose.quat_wxyz, pose.position]))


def _mink_library() -> Any:
    try:
        import mink
    except ImportError as error:
        raise StationError(
            f"retargeting needs mink, which is not installed ({error}); pip install 'teleop-station[retarget]'"
        ) from None
    return mink


def _model(joint_names: tuple[str, ...]) -> Any:
    """The built-in G1 on a fixed pelvis, with no other joints than these; its legs as in standing."""
    import mujoco

    spec = mujoco.MjSpec.from_file(str(assets.resolve(MODEL)))
    standing = dict(zip(LEGS, FORMAT.default[6:], strict=False))
    for part in (*spec.actuators, *spec.keys):
        spec.delete(part)
    spec.body("pelvis").pos = (0.0, 0.0, 0.0)
    for joint in list(spec.joints):
        name = joint.name.removesuffix("_joint")
        if name in joint_names:
            joint.range = _plausible(name, *joint.range)
            continue
        if standing.get(name):
            _bend(joint.parent, joint.axis, float(standing[name]))
        spec.delete(joint)
    return spec.compile()


def _plausible(name: str, lower: float, upper: float) -> tuple[float, float]:
    """Return the part of a joint's range [rad] that an operator's arms have too.

    A G1's go farther back and across than any person's, and no policy keeps it on its feet with both arms behind it.
    """
    if name.endswith("shoulder_pitch"):
        return lower, min(upper, _BEHIND_RAD)
    if name.endswith("shoulder_roll"):
        return (max(lower, -_ACROSS_RAD), upper) if name.startswith("left") else (lower, min(upper, _ACROSS_RAD))
    if name.endswith("shoulder_yaw"):
        return max(lower, -_TWISTED_RAD), min(upper, _TWISTED_RAD)
    return lower, upper


def _bend(body: Any, axis: Any, angle: float) -> None:
    import mujoco

    turn, quat = np.empty(4), np.empty(4)
    mujoco.mju_axisAngle2Quat(turn, np.array(axis), angle)
    mujoco.mju_mulQuat(quat, np.array(body.quat), turn)
    body.quat = quat


def _clear_of_the_body(mink: Any, model: Any) -> Any:
    """Forearms and hands keep away from trunk, head, thighs and each other: what the model lets touch."""
    arms = [geom for geom in range(model.ngeom) if model.geom_contype[geom]]
    solid = [geom for geom in range(model.ngeom) if model.geom_conaffinity[geom] > 1 or model.geom_contype[geom] > 1]
    arms = [geom for geom in arms if model.geom_contype[geom] > 1]
    return mink.CollisionAvoidanceLimit(
        model, [(arms, solid)], gain=_NEARS * _TICK_S,
        minimum_distance_from_collisions=_GAP_M, collision_detection_distance=_SEEN_M,
    )  # fmt: skip
