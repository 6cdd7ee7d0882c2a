"""The tool of one arm by the pose of one hand: pose in, pose out, whoever does the inverse kinematics: the robot, or
`adapters.retarget.tcp_ik`.

``TcpFollower.step(deltas.followed(snapshot.target, snapshot.start, hand), dt_s)`` is all there is to teleoperation by
differences: where the operator moves slower than the limits and within the workspace, the tool moves as the hand does.
"""

from __future__ import annotations

import numpy as np

from station import rotations
from station.operator.deltas import angle_between
from station.operator.sample import Pose
from station.protocols import Floats


class TcpFollower:
    """A pose that follows goals within a box, no faster than told; at a side of the box it slides along it.

    Args:
        pose: Where the tool is, in the frame of the robot's base.
        lower, upper: Corners of the box that the tool stays in, in that frame, shape (3,) [m]; a tool that begins
            outside comes in as its goals do, and never goes farther out.
        speed_mps, turn_rad_s: Greatest speeds [m/s, rad/s].

    Attributes:
        pose: Where the tool is asked to be.
    """

    def __init__(
        self, pose: Pose, *, lower: Floats, upper: Floats, speed_mps: float = 0.5, turn_rad_s: float = 1.5
    ) -> None:
        self.pose = pose
        self._lower, self._upper = np.asarray(lower), np.asarray(upper)
        self._speed_mps, self._turn_rad_s = speed_mps, turn_rad_s

    def reset(self, pose: Pose) -> None:
        """Go on from a pose, for example a measured one; not while engaged."""
        self.pose = pose

    def step(self, goal: Pose, dt_s: float) -> Pose:
        """Go towards a goal for a period [s]; return `pose`."""
        here = self.pose.position
        inside = np.clip(goal.position, np.minimum(self._lower, here), np.maximum(self._upper, here))
        way = inside - here
        part = _part(self._speed_mps * dt_s, float(np.linalg.norm(way)))
        turned = _part(self._turn_rad_s * dt_s, angle_between(self.pose.quat_wxyz, goal.quat_wxyz))
        quat = rotations.slerp(self.pose.quat_wxyz, goal.quat_wxyz, np.array(turned))
        self.pose = Pose(here + part * way, quat)
        return self.pose


def _part(allowed: float, wanted: float) -> float:
    return 1.0 if wanted <= allowed else allowed / wanted
