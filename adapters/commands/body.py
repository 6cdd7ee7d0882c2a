"""What TWIST's and TWIST2's command vectors share: a head that describes the root, then joints picked by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from adapters.robots.g1 import joints as g1
from station.contract import Element, elements, positions
from station.errors import ConfigError
from station.protocols import Floats, Reference, StockKeys

JOINT_MARGIN_RAD = 0.2
"""Retargeting overshoots a range by a few hundredths; 0.2 rad beyond it is another robot, or a fault."""


@dataclass(frozen=True, slots=True)
class ElementBound:
    """One element of the head.

    Attributes:
        name, unit: What it is.
        default: Its value when standing.
        lower, upper: Its range.
        margin: How far outside it is still clamped.
        rate: Greatest change per second.
        is_velocity: Whether it is a velocity of the root.
    """

    name: str
    unit: str
    default: float
    lower: float
    upper: float
    margin: float
    rate: float
    is_velocity: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class BodyCommand:
    """A command vector of the G1 (`station.protocols.CommandFormat`); its arrays are read-only.

    Attributes:
        joint_names: The joints that follow the head, in order.
        head: Makes the head from a reference.
    """

    name: str
    robot: str
    key: str
    elements: tuple[Element, ...]
    note: str
    auxiliary: Mapping[str, Floats]
    stock: StockKeys
    default: Floats
    lower: Floats
    upper: Floats
    margin: Floats
    rate: Floats
    velocities: tuple[int, ...]
    joint_names: tuple[str, ...]
    head: Callable[[Reference], list[float]]
    holds_position: bool = False

    def encode(self, reference: Reference, joint_names: tuple[str, ...]) -> Floats:
        """Return the vector that asks for a reference whose joints are named, shape (m,).

        Raises:
            ConfigError: the reference lacks a joint of this format.
        """
        columns = _columns(self.joint_names, joint_names)
        return np.concatenate([self.head(reference), reference.q[columns]])


def body_command(
    *,
    name: str,
    robot: str,
    key: str,
    note: str,
    auxiliary: Mapping[str, int],
    stock: StockKeys,
    bounds: tuple[ElementBound, ...],
    joint_names: tuple[str, ...],
    default_pose: Mapping[str, float],
    head: Callable[[Reference], list[float]],
) -> BodyCommand:
    """Put a format together; companions map a key to its number of zeros, absent joints stand at zero."""
    count = len(joint_names)
    pose = np.array([default_pose.get(joint, 0.0) for joint in joint_names])

    def whole(field: str, tail: Floats) -> Floats:
        return _frozen(np.concatenate([[getattr(bound, field) for bound in bounds], tail]))

    return BodyCommand(
        name=name,
        robot=robot,
        key=key,
        elements=(*(Element(bound.name, bound.unit) for bound in bounds), *elements((positions(joint_names), "rad"))),
        note=note,
        auxiliary=MappingProxyType({other: _frozen(np.zeros(size)) for other, size in auxiliary.items()}),
        stock=stock,
        default=whole("default", pose),
        lower=whole("lower", g1.lower(joint_names)),
        upper=whole("upper", g1.upper(joint_names)),
        margin=whole("margin", np.full(count, JOINT_MARGIN_RAD)),
        rate=whole("rate", g1.velocity(joint_names)),
        velocities=tuple(index for index, bound in enumerate(bounds) if bound.is_velocity),
        joint_names=joint_names,
        head=head,
    )


def standing(shoulder_roll: float) -> dict[str, float]:
    """Return TWIST's standing pose [rad]; its two releases differ in the shoulders. Joints not named are at zero."""
    pose = {"left_shoulder_roll": shoulder_roll, "right_shoulder_roll": -shoulder_roll}
    for side in ("left", "right"):
        pose |= {f"{side}_hip_pitch": -0.2, f"{side}_knee": 0.4, f"{side}_ankle_pitch": -0.2, f"{side}_elbow": 1.2}
    return pose


@lru_cache(maxsize=64)
def _columns(wanted: tuple[str, ...], available: tuple[str, ...]) -> list[int]:
    for name in wanted:
        if name not in available:
            raise ConfigError(f"the motion has no joint {name!r}; the command needs all of {', '.join(wanted)}")
    return [available.index(name) for name in wanted]


def _frozen(values: Floats) -> Floats:
    values.flags.writeable = False
    return values
