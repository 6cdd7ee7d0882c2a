"""What a Kassow arm says of itself; arms of the family differ in their limits, not in what is said of them."""

from __future__ import annotations

from adapters.robots.kassow.names import ARM_7, MAKER, suffix, without_name
from station.bus.robot_streams import driven_by_controller
from station.description import Joint, RobotDescription, RobotFamily


def describe(robot: str) -> RobotDescription | None:
    """Return the description of an arm by the suffix of its keys, limits left out; None for another maker's."""
    maker, _, model = robot.partition("_")
    if maker != MAKER or not model:
        return None
    return of_joints(robot, tuple(Joint(name) for name in ARM_7))


def of_joints(robot: str, joints: tuple[Joint, ...]) -> RobotDescription:
    """Return the description of an arm whose joints are known.

    Args:
        robot: Suffix of its keys.
        joints: With their limits.
    """
    return RobotDescription(
        name=robot,
        model=without_name(robot),
        joints=joints,
        drawn_as=f"builtin:{without_name(robot)}.xml",
        groups={"arm": tuple(joint.name for joint in joints)},
        streams=driven_by_controller(),
    )


FAMILY = RobotFamily((suffix("kr810"),), describe)
