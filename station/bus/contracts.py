"""What each key holds: what robots say of theirs, what is registered of those that say nothing, and the station's own.

A contract is written beside the bytes of a recording, never into them, so a wrong contract cannot spoil one.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from station import registry
from station.bus import joints, keys
from station.bus.robot_streams import command_stream
from station.contract import DEPTH_STEP_M, IMU, POSE, Codec, Contract, Element, Role, elements
from station.description import RobotDescription, RobotFamily, stated
from station.errors import StationError

if TYPE_CHECKING:  # it loads NumPy, as the formats do
    from station.protocols import CommandFormat, ForAnyRobot

_Made = TypeVar("_Made")

MOST_ROBOTS = 64
"""That are taken up from what servers state: a client may invent more."""

_REMEMBERED = 4096  # names and keys that were asked for; a client may invent more
_MOST_PARTS = 12  # of a key: a stranger's may have thousands

log = logging.getLogger(__name__)


class Contracts:
    """Contracts of the robots that were described to it, and of all that is known without that."""

    def __init__(self, servers: Iterable[Mapping[str, Any]] = ()) -> None:
        """Add what servers declare, each in its ``station:config:<server>``."""
        self._robots: dict[str, RobotDescription] = {}
        self._described: dict[str, Contract] = {}
        for facts in servers:
            self.add_facts(facts)

    def add_facts(self, facts: Mapping[str, Any]) -> None:
        """Add what a server declares, where that describes a robot."""
        if (robot := stated(facts)) is not None:
            self.describe(robot)

    def describe(self, robot: RobotDescription) -> None:
        """Add the description of a robot, in place of its earlier one; of `MOST_ROBOTS` and no more."""
        before = self._robots.get(robot.name)
        if before == robot or (before is None and len(self._robots) >= MOST_ROBOTS):
            return
        for item in before.contracts() if before is not None else ():
            self._described.pop(item.key, None)
        self._robots[robot.name] = robot
        self._described |= {item.key: item for item in robot.contracts()}

    def get(self, key: str) -> Contract | None:
        """Return the contract of a key, or None for a key that nothing describes."""
        return _of_everyone(key) or self._described.get(key) or _of_families(key)

    def all(self) -> tuple[Contract, ...]:
        """Return every contract with a fixed key."""
        return tuple({item.key: item for item in (*contracts(), *self._described.values())}.values())

    def robots(self) -> tuple[str, ...]:
        """Return the names of all robots, those first that described themselves."""
        return tuple(dict.fromkeys((*self._robots, *robots())))

    def of(self, robot: str) -> tuple[Contract, ...]:
        """Return what the keys of a robot hold; nothing of one that nothing describes."""
        if (described := self._robots.get(robot)) is not None:
            return described.contracts()
        return tuple(_of_another(robot).values())

    def robot(self, name: str) -> RobotDescription | None:
        """Return the description of a robot; None where nothing describes it."""
        return self._robots.get(name) or description(name)


def contract(key: str) -> Contract | None:
    """Return the contract of a key as it is known where no robot described itself, or None."""
    return _of_everyone(key) or _of_families(key)


def contracts() -> tuple[Contract, ...]:
    """Return every contract with a fixed key, in catalogue order."""
    return (*_of_listed().values(), *_of_station().values())


def load() -> None:
    """Load all that is registered, and NumPy with it; otherwise the first contract that is asked for takes 0.2 s."""
    contract("")


@lru_cache(maxsize=_REMEMBERED)
def description(robot: str) -> RobotDescription | None:
    """Return the description of a robot that is known though no server describes it; None for a stranger."""
    for name, family in _families():
        try:
            found = family.describe(robot)
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            log.warning("family %r: cannot say whether it knows %r: %s: %s", name, robot, type(error).__name__, error)
        else:
            if found is not None:
                return found
    return None


def robots() -> tuple[str, ...]:
    """Return the names of the robots that are known though no server describes them."""
    return tuple(name for _, family in _families() for name in family.names)


def of_joints(
    robot: str, role: Role, recorded: Iterable[Contract | None], description: RobotDescription | None
) -> list[str]:
    """Return which keys of a robot and a role tell of its joints, that of most joints first.

    Args:
        robot: Suffix of its keys.
        role: ``state`` or ``command``.
        recorded: Contracts of the keys that there are.
        description: Names its joints; None where nothing does, and each that has a position counts.
    """
    wanted = None if description is None else {f"{name}_pos" for name in description.joint_names}
    counts = {
        item.key: sum(name in wanted if wanted is not None else name.endswith("_pos") for name in item.names)
        for item in recorded
        if item is not None and item.role == role and item.key.endswith(f"_{robot}")
    }
    return sorted(filter(counts.__getitem__, counts), key=lambda key: (-counts[key], key))


@cache
def _families() -> tuple[tuple[str, RobotFamily], ...]:
    if outdated := registry.outdated():
        log.warning("%s, so keys of known robots have no names; %s", outdated, registry.INSTALL)
    return tuple(_sound("family", "its robots have no contracts", _expanded))


@cache
def _commands() -> tuple[tuple[str, Contract], ...]:
    """Contracts of the commands whose formats are registered, with the robot that each is for.

    Where several are for one robot, the first one names its `keys.command_used`.
    """
    return tuple((found.robot, command_stream(found)) for found in _formats() if found.key)


@cache
def _formats() -> tuple[CommandFormat, ...]:
    made = _sound("command", "its key has no contract", _command)
    return tuple(found for _, found in made)


@cache
def _formats_for_any() -> tuple[ForAnyRobot, ...]:
    """Formats with a key that any robot may take; found once, since the protocol check walks its attributes.

    A command of parts has no key: its parts have, and they are formats themselves.
    """
    from station.protocols import ForAnyRobot  # it loads NumPy

    return tuple(found for found in _formats() if isinstance(found, ForAnyRobot) and found.for_robot("any").key)


def _command(found: CommandFormat) -> CommandFormat:
    command_stream(found)
    return found


def _expanded(found: RobotFamily) -> RobotFamily:
    for name in found.names:
        if (described := found.describe(name)) is not None:
            described.contracts()
    return found


def _sound(kind: registry.Kind, trouble: str, make: Callable[[Any], _Made]) -> Iterator[tuple[str, _Made]]:
    """Make something of each that is registered, of ours first; with its name.

    A recorder records what comes; a registered contract that is wrong is told of and passed over.
    """
    for name in sorted(registry.names(kind), key=lambda name: not registry.is_ours(kind, name)):
        try:
            made = make(registry.find(kind, name))
        except (ImportError, AttributeError, TypeError, ValueError, StationError) as error:
            log.warning("%s %r: %s: %s: %s", kind, name, trouble, type(error).__name__, error)
        else:
            yield name, made


def _of_robot(robot: RobotDescription) -> dict[str, Contract]:
    """Contracts of a robot that no server describes: the command that it takes is the one that is registered."""
    commands = [made for name, made in _commands() if name == robot.name]
    found = {item.key: item for item in (*commands, *robot.contracts())}
    used = found.get(keys.command_used(robot.name))
    if used is not None and not used.elements and commands:
        found[used.key] = msgspec.structs.replace(used, elements=commands[0].elements)
    return found


@cache
def _of_listed() -> dict[str, Contract]:
    found = {made.key: made for _, made in _commands()}
    for name in robots():
        if (robot := description(name)) is not None:
            found |= _of_robot(robot)
    return found


@lru_cache(maxsize=_REMEMBERED)
def _of_another(robot: str) -> dict[str, Contract]:
    found = description(robot)
    return {} if found is None else _of_robot(found)


@lru_cache(maxsize=_REMEMBERED)
def _of_families(key: str) -> Contract | None:
    """Search the robots that are listed, then for a robot whose name is the end of the key."""
    if (listed := _of_listed().get(key)) is not None or keys.is_stamp(key):
        return listed
    parts = key.split("_")
    ends = ["_".join(parts[start:]) for start in range(1, min(len(parts), _MOST_PARTS))]
    known = (found for end in ends if (found := _of_another(end).get(key)) is not None)
    return next(known, None) or next(_of_any_robot(key, ends), None)


def _of_any_robot(key: str, robots: Iterable[str]) -> Iterator[Contract]:
    """Yield what a key holds that is one robot's command of a format for any."""
    general = _formats_for_any()
    for robot in robots if general else ():
        yield from (command_stream(bound) for found in general if (bound := found.for_robot(robot)).key == key)


def _of_everyone(key: str) -> Contract | None:
    """Keys that are the same for every robot, device, camera and lidar."""
    return _of_station().get(key) or _by_prefix(key) or _of_operator(key) or _of_camera(key) or _of_lidar(key)


def _station() -> list[Contract]:
    def make(key: str, role: Role, codec: Codec, note: str) -> Contract:
        return Contract(key=key, family="station", role=role, codec=codec, note=note)

    return [
        make(keys.ESTOP, "control", "json", "latched emergency stop: who asked for it and why; 0 when reset"),
        make(
            keys.ESTOP_PRESSED, "control", "json", "latched emergency stop, by who may not release one; gone when reset"
        ),
        make(keys.ARM, "control", "json", "arm or disarm: who asked and why; answered in the robot's command_gate"),
        make(
            keys.CONTROLLER,
            "control",
            "json",
            "clear a controller's faults, or choose its profile or throttle; answered in the robot's command_gate",
        ),
        make(keys.POLICY, "control", "json", "which policy shall drive a robot; answered in its command_gate"),
        make(keys.TWIN, "control", "json", "faults of a robot twin; answered in the heartbeat of its server"),
        make(keys.RUNBOOK, "control", "json", "what the runbook is doing: steps and the open question, twice a second"),
        make(
            keys.RUNBOOK_ANSWER, "control", "json", "an answer to its question; what came of it is in station:runbook"
        ),
        make(keys.EVENT, "event", "json", "one event: name, severity, source, numbers"),
        make(
            keys.MOTION_CONTROL, "control", "json", "start, pause, resume, seek, loop or leave, for the motion server"
        ),
        make(keys.RECORD, "control", "json", "a request to the recorder"),
        make(keys.RECORD_ACK, "control", "json", "the recorder's answer"),
        make(keys.RECORDER, "control", "json", "what the recorder is doing"),
        make(keys.TAP_PROBE, "network", "text", "written by a recorder to see that its tap delivers"),
    ]


_PREFIXES = {
    keys.SERVER_PREFIX: "health of a server, twice a second",
    keys.CLOCK_PREFIX: "a machine's clock beside the bus server's, every second",
    keys.HOST_PREFIX: "servers that a station wants on another machine, twice a second",
    keys.LOG_PREFIX: "newest lines that a server on another machine printed",
    keys.CONFIG_PREFIX: "what a server runs: policy, hashes, gains, rates, code revision",
}


def _by_prefix(key: str) -> Contract | None:
    for prefix, note in _PREFIXES.items():
        if key.startswith(prefix):
            return Contract(key=key, family="station", role="control", codec="json", note=note)
    return None


_TWIST = elements((("vx", "vy", "vz", "wx", "wy", "wz"), ""))
_BODY_POS = elements((tuple(f"{name}_{axis}" for name in joints.SMPL_24 for axis in "xyz"), "m"))
_BODY_QUAT = elements((tuple(f"{name}_q{axis}" for name in joints.SMPL_24 for axis in "wxyz"), ""))
_HAND = tuple(Element(f"{name}_{item.name}", item.unit) for name in joints.HAND_26 for item in POSE)
_WORLD = "the operator's world: x forward, y left, z up"

_OPERATOR: dict[str, tuple[Codec, tuple[Element, ...], str]] = {
    keys.operator_status(""): ("json", (), "live, stale or lost, and why; counts of new samples and of repetitions"),
    keys.operator_controls(""): ("json", (), "number by name: axes -1 to 1, triggers 0 to 1, buttons 0 or 1"),
    keys.operator_head(""): ("f64", POSE, _WORLD),
    keys.operator_left(""): ("f64", POSE, _WORLD),
    keys.operator_right(""): ("f64", POSE, _WORLD),
    keys.operator_body_pos(""): ("f64", _BODY_POS, _WORLD),
    keys.operator_body_quat(""): ("f64", _BODY_QUAT, f"{_WORLD}; a bone's orientation stands at its upper joint"),
    keys.operator_hand_left(""): ("f64", _HAND, _WORLD),
    keys.operator_hand_right(""): ("f64", _HAND, _WORLD),
    keys.operator_twist(""): ("f64", _TWIST, "-1 to 1 of full deflection; x forward, y left, z up"),
    keys.operator_joints(""): ("f64", (), "joint positions of the leader [rad], then its gripper from 0 to 1"),
}
"""Codec, elements and note by the beginning of a key; the name of the device server follows."""


def _of_operator(key: str) -> Contract | None:
    for prefix, (codec, items, note) in _OPERATOR.items():
        if key.startswith(prefix) and not keys.is_stamp(key):
            rate_hz = 100.0 if prefix == keys.operator_status("") else None  # samples come as the device gives them
            return Contract(
                key=key, family="station", role="sensor", codec=codec, elements=items, rate_hz=rate_hz, note=note
            )
    return None


def _of_camera(key: str) -> Contract | None:
    if keys.is_stamp(key):
        return None
    when = "the stamp's capture_ns is when it was taken, on its writer's monotonic clock"
    if key.startswith(keys.camera_image("")):
        note = f"one JPEG file per picture; {when}"
        return Contract(key=key, family="station", role="sensor", codec="jpeg", rate_hz=30.0, note=note)
    if key.startswith(keys.camera_depth("")):
        note = (
            "one PNG file per picture, a channel of 16 bits in millimetres along the optical axis, 0 for no depth; "
            f"written with the camera's picture of the same moment; {when}"
        )
        return Contract(
            key=key, family="station", role="sensor", codec="png", rate_hz=30.0, step_m=DEPTH_STEP_M, note=note
        )
    return None


def _of_lidar(key: str) -> Contract | None:
    if keys.is_stamp(key):
        return None
    if key.startswith(keys.lidar_cloud("")):
        note = (
            "a foxglove.PointCloud without its time: fields, stride and points as the sensor gave them, its mount as "
            "the pose; the stamp's capture_ns is when the cloud was whole, on its writer's monotonic clock"
        )
        return Contract(key=key, family="station", role="sensor", codec="point-cloud", rate_hz=10.0, note=note)
    if key.startswith(keys.lidar_imu("")):
        note = "in the lidar's own frame"
        return Contract(key=key, family="station", role="sensor", codec="f64", elements=IMU, rate_hz=200.0, note=note)
    return None


@cache
def _of_station() -> dict[str, Contract]:
    return {item.key: item for item in _station()}
