"""How an operator moves the tool of an arm: a goal that stays near the tool, within a box and a speed limit."""

from __future__ import annotations

import numpy as np

from adapters.retarget import tcp_ik
from adapters.retarget.tcp_ik import TcpFollower
from adapters.robots.serial_chain import SerialChain
from station import rotations
from station.operator import deltas
from station.operator.sample import Pose
from station.protocols import Floats

LEAD_M, LEAD_RAD = 0.01, 0.05
"""A goal goes no farther ahead of a tool that cannot follow, so that turning back acts at once [m, rad]."""

_STUCK = 0.05
"""Of the way that a joint may go in a tick: a tool whose joints all go less far towards its goal is at its end."""


class ArmTool:
    """The tool of one arm.

    Args:
        chain: The arm.
        speed_rad_s: Greatest speed of each joint [rad/s].
        tool_mps, tool_rad_s: Greatest speeds of the tool [m/s, rad/s].
        box: Corners that the tool stays between, in the frame of the base, shape (2, 3) [m].
    """

    def __init__(
        self, chain: SerialChain, *, speed_rad_s: float, tool_mps: float, tool_rad_s: float, box: Floats
    ) -> None:
        self._chain, self._speed_rad_s = chain, speed_rad_s
        self._tool_mps, self._tool_rad_s = tool_mps, tool_rad_s
        nowhere = Pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
        self._preferred: Floats = np.zeros(len(chain))
        self._is_stuck = False
        self._follower = TcpFollower(nowhere, lower=box[0], upper=box[1], speed_mps=tool_mps, turn_rad_s=tool_rad_s)

    def pose(self, q: Floats) -> Pose:
        """Return where the tool is for joints, shape (7,) [rad], in the frame of the base."""
        return self._chain.posture(q).pose

    def rest(self, q: Floats) -> None:
        """Ask for nothing more than where the tool is; the elbow that it has now is the preferred one."""
        self._stop(q)
        self._preferred = q.copy()

    def twist(
        self, q: Floats, deflection: Floats, axes_wxyz: Floats, dt_s: float, lower: Floats, upper: Floats
    ) -> Floats:
        """Move the tool along and about some axes for a period [s]; return the joints, shape (7,) [rad].

        Args:
            q: Joints before, shape (7,) [rad].
            deflection: vx vy vz wx wy wz, -1 to 1 of the greatest speeds, shape (6,); all zero stops at once.
            axes_wxyz: Orientation of the axes in the frame of the base.
            dt_s: The period.
            lower, upper: Range of the joints, shape (7,) [rad].
        """
        if not deflection.any():
            self._stop(q)
            return q
        tool, asked = self.pose(q), self._follower.pose
        way = deflection * np.repeat([self._tool_mps, self._tool_rad_s], 3) * dt_s
        goal = _moved(asked, way, axes_wxyz)
        if _is_ahead(goal, asked, tool):
            goal = asked  # the tool has to catch up, or else does what it can of each axis alone
            for axis in np.flatnonzero(way) if self._is_stuck else ():
                alone = _moved(goal, way * np.eye(6)[axis], axes_wxyz)
                goal = goal if _is_ahead(alone, goal, tool) else alone
        return self._go(q, self._follower.step(goal, dt_s), dt_s, lower, upper)

    def follow(self, q: Floats, goal: Pose, dt_s: float, lower: Floats, upper: Floats) -> Floats:
        """Move the tool towards a pose in the frame of the base for a period [s]; return the joints like `twist`."""
        asked = self._follower.step(goal, dt_s)
        moved = self._go(q, asked, dt_s, lower, upper)
        self._follower.reset(_led(asked, self.pose(moved)))
        return moved

    def _stop(self, q: Floats) -> None:
        self._follower.reset(self.pose(q))
        self._is_stuck = False

    def _go(self, q: Floats, asked: Pose, dt_s: float, lower: Floats, upper: Floats) -> Floats:
        reach = self._speed_rad_s * dt_s
        moved = tcp_ik.step(self._chain, q, asked, reach, lower, upper, self._preferred)
        self._is_stuck = float(np.abs(moved - q).max()) < _STUCK * reach
        return moved


def _moved(pose: Pose, way: Floats, axes_wxyz: Floats) -> Pose:
    """Return a pose after a way along and about axes, shape (6,) [m, rad]."""
    turn = rotations.from_rotation_vector(rotations.rotate(axes_wxyz, way[3:]))
    quat = rotations.normalized(rotations.multiply(turn, pose.quat_wxyz))
    return Pose(pose.position + rotations.rotate(axes_wxyz, way[:3]), quat)


def _ahead(asked: Pose, tool: Pose) -> tuple[float, float]:
    metres = float(np.linalg.norm(asked.position - tool.position))
    return metres, deltas.angle_between(tool.quat_wxyz, asked.quat_wxyz)


def _is_ahead(goal: Pose, asked: Pose, tool: Pose) -> bool:
    """Whether a goal is too far ahead of the tool, and farther than what was asked for before."""
    (metres, radians), (metres_before, radians_before) = _ahead(goal, tool), _ahead(asked, tool)
    return metres > max(LEAD_M, metres_before) or radians > max(LEAD_RAD, radians_before)


def _led(asked: Pose, tool: Pose) -> Pose:
    """Return what is asked for, or what lies on the way there as far ahead of the tool as it may."""
    metres, radians = _ahead(asked, tool)
    if metres <= LEAD_M and radians <= LEAD_RAD:
        return asked
    part, turned = LEAD_M / max(metres, LEAD_M), LEAD_RAD / max(radians, LEAD_RAD)
    way = asked.position - tool.position
    return Pose(tool.position + part * way, rotations.slerp(tool.quat_wxyz, asked.quat_wxyz, np.array(turned)))
