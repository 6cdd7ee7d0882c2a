"""Where the robot was and where it was asked to be, as root poses and joints over time."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from station import rotations
from station.bus import codec, contracts, keys
from station.bus.robot_streams import ROOT
from station.bus.sample import Sample
from station.contract import Contract, names_of
from station.description import RobotDescription
from station.protocols import Floats

Ints = NDArray[np.int64]
STANDING_M = 0.79
"""Height at which a robot is drawn whose height nothing measures and no command says."""

_AT_THE_ORIGIN = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


class Posture(NamedTuple):
    """Root pose and joints at n instants.

    Attributes:
        times_ns: Shape (n,).
        root: Position [m] and quaternion wxyz, shape (n, 7).
        joints: Names of m joints.
        q: Their positions, shape (n, m) [rad].
    """

    times_ns: Ints
    root: Floats
    joints: tuple[str, ...]
    q: Floats


class Numbers(NamedTuple):
    """The values of a key, shape (n, m), when they arrived, shape (n,) [ns], and what they are."""

    times_ns: Ints
    values: Floats
    contract: Contract


Find = Callable[[str], Numbers | None]


def newest(sample: Sample | None, contract: Contract) -> Numbers | None:
    """Return the numbers of a key's newest value as one instant; None for none, or where they are not as described."""
    if sample is None or (kind := contract.vector_codec) is None:
        return None
    try:
        values = codec.parse_vector(kind, sample.value)
    except codec.BadValue:
        return None
    if len(values) != len(contract.elements):
        return None
    return Numbers(np.array([sample.arrived_ns or 0]), values[None], contract)


def state_keys(robot: str, recorded: Iterable[Contract | None], description: RobotDescription | None) -> list[str]:
    """Return the keys that say where a robot is: ground truth, else what it measured of itself."""
    own = [keys.sim_qpos(robot), keys.robot_state(robot)]
    return list(dict.fromkeys((*own, *contracts.of_joints(robot, "state", recorded, description))))


def command_keys(robot: str, recorded: Iterable[Contract | None], description: RobotDescription | None) -> list[str]:
    """Return the keys that say what a robot is asked to be: what its gate let through, else what is on the bus."""
    return [keys.command_used(robot), *contracts.of_joints(robot, "command", recorded, description)]


def measured(find: Find, states: Iterable[str], description: RobotDescription | None) -> Posture | None:
    """Return where a robot was, from the best of its states that is there.

    A robot that does not know where it stands is drawn in place; one without a base stands fast, at the origin.

    Args:
        find: Gives the numbers of a key, or None.
        states: Keys as of `state_keys`.
        description: Says whether it has a base; None where nothing does.
    """
    has_base = description is None or description.has_base
    for key in states:
        numbers = find(key)
        if numbers is None:
            continue
        names, values = numbers.contract.names, numbers.values
        joints, q = _joints(names, values)
        root = _root(names, values)
        if root is None and not has_base:
            root = np.tile(_AT_THE_ORIGIN, (len(values), 1))
        if joints and root is not None:
            return Posture(numbers.times_ns, root, joints, q)
    return None


def asked(find: Find, commands: Iterable[str], where: Posture) -> Posture | None:
    """Return what a robot was asked to be, by the first of its commands that is there (`command_keys`)."""
    for key in commands:
        numbers = find(key)
        if numbers is not None and _joints(numbers.contract.names, numbers.values)[0]:
            return reference(numbers.times_ns, numbers.contract.names, numbers.values, where)
    return None


def reference(times_ns: Ints, names: tuple[str, ...], values: Floats, measured: Posture) -> Posture:
    """Return the posture that commands ask for.

    The command of a robot that walks says height, roll and pitch; place and heading are those that it had at that time.

    Args:
        times_ns: Instants of n commands.
        names: Elements of the command.
        values: Commands, shape (n, elements).
        measured: Where the robot was.
    """
    joints, q = _joints(names, values)
    nearest = np.clip(np.searchsorted(measured.times_ns, times_ns, side="right") - 1, 0, len(measured.times_ns) - 1)
    root = measured.root[nearest].copy()
    if "root_height" not in names:
        return Posture(times_ns, root, joints, q)
    root[:, 2:3] = _columns(names, values, ("root_height",))
    roll_pitch = _columns(names, values, ("root_roll", "root_pitch"))
    yaw = rotations.roll_pitch_yaw(root[:, 3:])[:, 2]
    root[:, 3:] = from_roll_pitch_yaw(roll_pitch[:, 0], roll_pitch[:, 1], yaw)
    return Posture(times_ns, root, joints, q)


def from_roll_pitch_yaw(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    """Return quaternions wxyz of ZYX Euler angles, shapes (n,) [rad]."""
    turns = []
    for angle, axis in ((yaw, (0.0, 0.0, 1.0)), (pitch, (0.0, 1.0, 0.0)), (roll, (1.0, 0.0, 0.0))):
        turns.append(rotations.from_rotation_vector(np.asarray(angle)[:, None] * np.array(axis)))
    return rotations.multiply(rotations.multiply(turns[0], turns[1]), turns[2])


_ROOT = names_of(ROOT)


def _root(names: tuple[str, ...], values: Floats) -> Floats | None:
    """Return root poses, shape (n, 7), or None where nothing tells the orientation."""
    place = np.tile([0.0, 0.0, STANDING_M], (len(values), 1))
    if set(_ROOT) <= set(names):
        return _columns(names, values, _ROOT)
    if set(_ROOT[3:]) <= set(names):
        return np.hstack([place, _columns(names, values, _ROOT[3:])])
    if {"root_roll", "root_pitch"} <= set(names):
        roll, pitch = _columns(names, values, ("root_roll", "root_pitch")).T
        return np.hstack([place, from_roll_pitch_yaw(roll, pitch, np.zeros_like(roll))])
    return None


def _columns(names: tuple[str, ...], values: Floats, wanted: tuple[str, ...]) -> Floats:
    return values[:, [names.index(name) for name in wanted]]


def _joints(names: tuple[str, ...], values: Floats) -> tuple[tuple[str, ...], Floats]:
    indices = [index for index, name in enumerate(names) if name.endswith("_pos")]
    return tuple(names[index].removesuffix("_pos") for index in indices), values[:, indices]
