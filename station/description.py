"""What a robot says of itself: its name, its joints, and what each of its keys holds.

Names, units, curves, columns and limits follow from it, so the rest of the station knows no robot.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from station.contract import Contract, Element

ROBOT, JOINT = "{robot}", "{joint}"
"""In a key of a description: the robot's name. In the name of an element: repeated for each of its joints, in order."""

_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")  # it ends keys
_MOST_JOINTS, _MOST_STREAMS, _MOST_ELEMENTS = 256, 64, 4096


class Joint(msgspec.Struct, frozen=True):
    """One joint; None where a number is not known.

    Attributes:
        name: A valid field name, as in ``left_knee``.
        lower, upper: Ends of its range [rad].
        speed: Greatest speed [rad/s].
        torque: Greatest torque [N m].
    """

    name: str
    lower: float | None = None
    upper: float | None = None
    speed: float | None = None
    torque: float | None = None


class RobotDescription(msgspec.Struct, frozen=True, kw_only=True):
    """A robot as its low-level server states it, in ``station:config:<server>``.

    Attributes:
        name: Of this robot, the suffix of its keys: ``unitree_g1_with_hands``, ``left_arm``.
        model: What kind of robot it is: ``unitree_g1``.
        short: In names of episodes: ``g1``; "" for its name.
        joints: The n joints, in the order of its vectors.
        groups: Names of joints by limb, for curves and views: ``left leg``.
        parts: Keys of command and state of what it moves beside its body, by name: ``left hand``.
        drawn_as: Its model where its server names none: a path or ``collection:path``; "" for none.
        has_base: Whether it stands on its own and can fall; else it is fixed to the ground.
        is_carried: Whether it is a hand, a neck or a tool on another robot: it may be still, rest at its ends, and be
            stopped by what it holds.
        streams: What its keys hold, with `ROBOT` and `JOINT` where they stand for the robot's own.
    """

    name: str
    model: str
    short: str = ""
    joints: tuple[Joint, ...]
    groups: dict[str, tuple[str, ...]] = {}
    parts: dict[str, tuple[str, str]] = {}
    drawn_as: str = ""
    has_base: bool = False
    is_carried: bool = False
    streams: tuple[Contract, ...] = ()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in order."""
        return tuple(joint.name for joint in self.joints)

    def part_keys(self) -> dict[str, tuple[str, str]]:
        """Return the keys of command and state of each of its parts, by name."""
        named = {name: tuple(key.replace(ROBOT, self.name) for key in pair) for name, pair in self.parts.items()}
        return {name: (command, state) for name, (command, state) in named.items()}

    def contracts(self) -> tuple[Contract, ...]:
        """Return what each of its keys holds, one contract per key."""
        return tuple(
            msgspec.structs.replace(
                stream, key=stream.key.replace(ROBOT, self.name), elements=self._expanded(stream.elements)
            )
            for stream in self.streams
        )

    def _expanded(self, elements: tuple[Element, ...]) -> tuple[Element, ...]:
        found: list[Element] = []
        for element in elements:
            names = self.joint_names if JOINT in element.name else ("",)
            found += [Element(element.name.replace(JOINT, name), element.unit) for name in names]
        return tuple(found)


class RobotFamily(msgspec.Struct, frozen=True):
    """Robots that are known though no server describes them: stock programs state nothing, nor do old episodes.

    Attributes:
        names: Those that are listed.
        describe: Returns the description of a robot by its name, of others than those listed too; None for a stranger.
    """

    names: tuple[str, ...]
    describe: Callable[[str], RobotDescription | None]


def stated(facts: Mapping[str, Any]) -> RobotDescription | None:
    """Return the description in what a server states; None where there is none, or one that no server of ours makes."""
    try:
        found = msgspec.convert(facts.get("description"), RobotDescription)
    except msgspec.ValidationError:
        return None
    return found if _is_sound(found) else None


def _is_sound(description: RobotDescription) -> bool:
    """Whether its size is that of a robot, and its names can stand in files."""
    if _NAME.fullmatch(description.name) is None:
        return False
    names = [element.name for stream in description.streams for element in stream.elements]
    many = sum(JOINT in name for name in names)
    is_bounded = (
        len(description.joints) <= _MOST_JOINTS
        and len(description.streams) <= _MOST_STREAMS
        and len(names) + many * len(description.joints) <= _MOST_ELEMENTS
    )
    listed = [description.joint_names, *(item.names for item in description.contracts())] if is_bounded else []
    return is_bounded and all(
        len(set(each)) == len(each) and all(name.isidentifier() for name in each) for each in listed
    )
