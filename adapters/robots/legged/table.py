"""What a robot on legs is to the adapter: a row of data. Imports nothing heavy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

Axis = Literal["x", "y", "z"]


@dataclass(frozen=True, slots=True)
class Joint:
    """One joint.

    Attributes:
        name: Name on the wire: that of the maker's MJCF, without its ``_joint``.
        axis: Axis in the frame of its own link.
        lower, upper: Range [rad].
        effort_nm: Greatest torque [N m].
        velocity_rad_s: Greatest speed [rad/s].
        armature: Rotor inertia seen at the joint [kg m^2].
    """

    name: str
    axis: Axis
    lower: float
    upper: float
    effort_nm: float
    velocity_rad_s: float
    armature: float

    @property
    def mjcf_name(self) -> str:
        """Name in the maker's MJCF and URDF files."""
        return f"{self.name}_joint"


@dataclass(frozen=True, slots=True, kw_only=True)
class LeggedRobot:
    """A robot with a floating base; n joints, in the order of every vector.

    Attributes:
        name: Suffix of its keys: ``go2``.
        model: What kind of robot it is: ``unitree_go2``.
        title: What a person calls it: ``Unitree Go2``.
        mjcf: Its model, a path or ``collection:path``.
        joints: The n joints.
        motors: Of each joint, its index in the maker's own messages.
        groups: Names of joints by limb.
        root: Body with the free joint.
        feet: How the names of bodies end that may touch the ground, with what hangs on them.
        start_q: Joints at the start, which is how it stands without a policy [rad].
        start_height_m: Height of the root at the start [m].
        stand_kp, stand_kd: Gains that hold it there [N m/rad, N m s/rad].
        least_height_m: A root below it has fallen [m]; 0 where only its lean and what touches the ground say so.
        clip_nm: Greatest torque of each servo [N m]; () for the efforts of the joints.
        fills_armature: Whether a joint without rotor inertia in the model is given the table's.
        follows_motions: Whether a motion with joints of these names is one of its body. H1-2 and G1 share names, and no
            proportions.
    """

    name: str
    model: str
    title: str
    mjcf: str
    joints: tuple[Joint, ...]
    motors: tuple[int, ...]
    groups: Mapping[str, tuple[str, ...]]
    root: str
    feet: tuple[str, ...]
    start_q: tuple[float, ...]
    start_height_m: float
    stand_kp: tuple[float, ...]
    stand_kd: tuple[float, ...]
    least_height_m: float = 0.0
    clip_nm: tuple[float, ...] = ()
    fills_armature: bool = True
    follows_motions: bool = False

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name for joint in self.joints)

    @property
    def torques_nm(self) -> tuple[float, ...]:
        """Greatest torque of each servo [N m]."""
        return self.clip_nm or tuple(joint.effort_nm for joint in self.joints)


def mirrored(left: tuple[Joint, ...]) -> Iterator[Joint]:
    """Yield the joints of the right side: ranges about x and z turn over in the plane between the sides."""
    for joint in left:
        lower, upper = (joint.lower, joint.upper) if joint.axis == "y" else (-joint.upper, -joint.lower)
        yield replace(joint, name=joint.name.replace("left_", "right_"), lower=lower, upper=upper)
