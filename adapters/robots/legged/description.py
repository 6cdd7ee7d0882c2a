"""What a robot on legs says of itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from adapters.robots.legged.table import LeggedRobot
from adapters.robots.legged.unitree import ROBOTS
from station.bus import keys
from station.bus.robot_streams import POSITIONS, command_streams, driven_by_policy
from station.contract import Contract
from station.description import ROBOT, Joint, RobotDescription, RobotFamily

if TYPE_CHECKING:  # it loads NumPy
    from station.protocols import CommandFormat


def described(
    robot: LeggedRobot,
    name: str,
    streams: tuple[Contract, ...],
    *,
    short: str = "",
    parts: Mapping[str, tuple[str, str]] | None = None,
) -> RobotDescription:
    """Return the description of a robot under a name, with what is on its keys.

    Args:
        robot: The robot.
        name: Suffix of its keys.
        streams: What its keys hold.
        short, parts: As in `station.description.RobotDescription`.
    """
    return RobotDescription(
        name=name,
        model=robot.model,
        short=short,
        joints=tuple(
            Joint(joint.name, joint.lower, joint.upper, joint.velocity_rad_s, joint.effort_nm) for joint in robot.joints
        ),
        groups=dict(robot.groups),
        parts=dict(parts or {}),
        drawn_as=robot.mjcf,
        has_base=True,
        streams=streams,
    )


def of_server(robot: LeggedRobot, command_format: CommandFormat) -> RobotDescription:
    """Return the description of a robot whose policy takes a command."""
    driven = driven_by_policy(command_format.elements)
    return described(robot, command_format.robot, (*command_streams(command_format), *driven))


def _known(name: str) -> RobotDescription | None:
    if name not in ROBOTS:
        return None
    joints = Contract(
        key=keys.action_joints(ROBOT), family="joints", role="command", codec="json-vector", elements=POSITIONS,
        rate_hz=50.0, note="absolute; what the policy `direct` stands and moves by",
    )  # fmt: skip
    return described(ROBOTS[name], name, (joints, *driven_by_policy()))


FAMILY = RobotFamily(tuple(ROBOTS), _known)
