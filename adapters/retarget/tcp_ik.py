"""Inverse kinematics of one arm for a tick: how far its joints go towards a pose of the tool.

Damped least squares on the Jacobian; a joint that would leave its range stays at its end and the others do its part;
where one would be too fast all go slower, so that the tool keeps its direction. What a seventh joint leaves open, where
the elbow is, goes back to a preferred posture while the tool moves: a tool that comes back brings its elbow back, too.
Pure, light, and without a solver.
"""

from __future__ import annotations

import numpy as np

from adapters.robots.serial_chain import SerialChain
from station import rotations
from station.operator.deltas import angle_between
from station.operator.sample import Pose
from station.protocols import Floats

ARM_LENGTH_M = 0.3
"""A radian of the tool's orientation counts as much as this many metres of its position [m]."""

DAMPED_BELOW = 0.04
"""Least singular value of the Jacobian below which steps are damped [m/rad]: an arm stretched out, or folded upon
itself, would otherwise ask for any joint speed."""

DAMPING = 0.05
"""Greatest damping, at a singularity [m/rad]."""


def step(
    chain: SerialChain, q: Floats, goal: Pose, reach_rad: float, lower: Floats, upper: Floats, preferred: Floats
) -> Floats:
    """Return the joints after a tick on their way to a pose.

    Args:
        chain: The arm.
        q: Its joints, shape (n,) [rad], within the range.
        goal: Of the tool, in the frame of the base.
        reach_rad: How far each joint may go in this tick [rad].
        lower, upper: Range of each joint, shape (n,) [rad].
        preferred: Where the joints would be best, as far as the goal leaves that open, shape (n,) [rad].

    Returns:
        Joints within the range, none farther than `reach_rad` from `q`, shape (n,).
    """
    posture = chain.posture(q)
    error, jacobian = _error(posture.pose, goal), posture.jacobian()
    jacobian[3:] *= ARM_LENGTH_M
    way = _within(jacobian, error, lower - q, upper - q, preferred - q)
    fastest = float(np.abs(way).max())
    if fastest > reach_rad:
        way *= reach_rad / fastest
    return np.clip(q + way, lower, upper)


def _error(here: Pose, goal: Pose) -> Floats:
    turn = rotations.multiply(goal.quat_wxyz, rotations.inverse(here.quat_wxyz))
    return np.concatenate([goal.position - here.position, ARM_LENGTH_M * rotations.rotation_vector(turn)])


def _within(jacobian: Floats, error: Floats, lower: Floats, upper: Floats, preferred: Floats) -> Floats:
    """Solve for joint ways within a range; what one joint may not do the others try."""
    way = np.zeros(len(lower))
    free = np.ones(len(lower), dtype=bool)
    while free.any():
        way[free] = _damped(jacobian[:, free], error - jacobian[:, ~free] @ way[~free], preferred[free])
        beyond = free & ((way < lower) | (way > upper))
        if not beyond.any():
            return way
        way[beyond] = np.clip(way[beyond], lower[beyond], upper[beyond])
        free &= ~beyond
    return way


def _damped(jacobian: Floats, error: Floats, preferred: Floats) -> Floats:
    """Return the least joint ways that bring an error nearly to zero, none far where a direction is almost lost; and,
    where there are more joints than it takes, as far again towards preferred ways as that moves no tool."""
    left, sizes, right = np.linalg.svd(jacobian)
    lost = max(0.0, 1.0 - float(sizes[-1]) / DAMPED_BELOW)
    damping = (DAMPING * lost) ** 2
    count = len(sizes)
    way = right[:count].T @ (sizes / (sizes * sizes + damping) * (left[:, :count].T @ error))
    most = float(np.abs(way).max())
    for idle in right[count:]:
        way = way + min(max(float(idle @ preferred), -most), most) * idle
    return np.asarray(way)


class TcpFollower:
    """A pose that follows goals within a box and a speed limit; at a side of the box it slides along it.

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
