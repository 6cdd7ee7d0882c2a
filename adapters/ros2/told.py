"""Values of the bus as messages of a running ROS 2 graph: the functions that write bags, by the rows of a table."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from adapters.exports.jointstate import JointStates
from adapters.exports.ros2 import messages
from adapters.ros2.table import Joints, PublishRow
from station.bus.robot_streams import GYRO, QUAT, ROOT
from station.contract import IMU, WORLD_FRAME, Contract, names_of
from station.episode.reading.vectors import decoder
from station.errors import ConfigError
from station.point_cloud import BadCloud, decoded
from station.rotations import rotate_inverse

Tell = Callable[[bytes, int], bytes | None]
"""``(value, written_ns) -> message``; None for a value that does not fit its contract."""

_PLANAR = ("vx", "vy", "wz")
_DOWN = np.array([0.0, 0.0, -1.0])
_ACCELERATION = names_of(IMU[3:])
_CLOCK = struct.Struct("<4siI")
_TWIST = struct.Struct("<4s6d")
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_EMPTY_LAYOUT = struct.pack("<II", 0, 0)
_NANOSECONDS = 1_000_000_000

STOPPED = _TWIST.pack(_LITTLE_ENDIAN, *[0.0] * 6)
"""A Twist of zeros."""


def last_word(row: PublishRow) -> bytes:
    """Return the message that tells a robot to stand, for the end of a topic's commands; nothing for other topics."""
    if not row.drives or not row.ends_after_s:
        return b""
    return STOPPED if row.kind == "twist" else messages.twist(0, row.frame, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def teller(row: PublishRow, contract: Contract | None) -> Tell:
    """Return what makes the messages of a topic of the values of its key.

    Args:
        row: Of the table.
        contract: What the key holds; None where nothing describes it.

    Raises:
        ConfigError: such a key cannot be such messages.
    """
    if row.kind == "clock":
        return lambda _, ns: _CLOCK.pack(_LITTLE_ENDIAN, *divmod(ns, _NANOSECONDS))
    if contract is None:
        raise ConfigError(f"{row.topic}: nothing describes the key {row.key!r}")
    wanted = {"compressed-image": "jpeg", "point-cloud": "point-cloud"}.get(row.kind)
    if wanted is not None:
        if contract.codec != wanted:
            raise ConfigError(f"{row.topic}: {row.key!r} holds {contract.codec}, a {row.kind} is made of {wanted}")
        frame = row.frame
        return (lambda data, ns: messages.jpeg(ns, frame, data)) if wanted == "jpeg" else _cloud(frame)
    if contract.vector_codec is None:
        raise ConfigError(f"{row.topic}: {row.key!r} holds {contract.codec}, a {row.kind} is made of numbers")
    make = _of_numbers(row, contract)
    read, length = _reader(contract), len(contract.elements)

    def tell(data: bytes, written_ns: int) -> bytes | None:
        numbers = read(data)
        return None if numbers is None or (length and len(numbers) != length) else make(numbers, written_ns)

    return tell


def _reader(contract: Contract) -> Callable[[bytes], Any]:
    """Return what makes numbers of a value: no array, of which a few numbers are slower to take up than of a tuple."""
    code = {"f64": "d", "f32": "f"}.get(contract.codec, "")
    if not code or not contract.elements:
        return decoder(contract.codec)
    layout = struct.Struct(f"<{len(contract.elements)}{code}")
    return lambda data: layout.unpack(data) if len(data) == layout.size else None


def _of_numbers(row: PublishRow, contract: Contract) -> Callable[[Any, int], bytes]:
    place = {name: index for index, name in enumerate(contract.names)}

    def places(names: Sequence[str]) -> list[int]:
        if missing := [name for name in names if name not in place]:
            raise ConfigError(f"{row.topic}: a {row.kind} needs {missing[0]!r}, which {row.key!r} does not hold")
        return [place[name] for name in names]

    frame = row.frame
    match row.kind:
        case "joint-state":
            return _joints(row.joints, contract, places)
        case "imu":
            return _imu(row, places(GYRO), places(QUAT), place)
        case "twist" | "twist-stamped":
            planar = places(_PLANAR)

            def twist(numbers: Any, ns: int) -> bytes:
                vx, vy, wz = (float(numbers[one]) for one in planar)
                if row.kind == "twist":
                    return _TWIST.pack(_LITTLE_ENDIAN, vx, vy, 0.0, 0.0, 0.0, wz)
                return messages.twist(ns, frame, (vx, vy, 0.0), (0.0, 0.0, wz))

            return twist
        case "transform":
            root = places(names_of(ROOT))
            return lambda numbers, ns: messages.transform(ns, WORLD_FRAME, frame, [numbers[one] for one in root])
    return _float32s


def _float32s(numbers: Any, _: int) -> bytes:
    found = np.asarray(numbers, dtype="<f4")
    return _LITTLE_ENDIAN + _EMPTY_LAYOUT + struct.pack("<I", len(found)) + found.tobytes()


def _joints(
    joints: Joints | None, contract: Contract, places: Callable[[Sequence[str]], list[int]]
) -> Callable[[Any, int], bytes]:
    """Return what makes a JointState: positions, and velocities and efforts where the key has those of every joint."""
    is_as_ours = joints is None
    if joints is None:
        names = [name.removesuffix("_pos") for name in contract.names if name.endswith("_pos")]
        joints = Joints(names=tuple(names) or ("",))
    held, count = {*contract.names}, len(joints.names)
    found = [places([f"{name}_pos" for name in joints.names])]
    for ending in ("_vel", "_torque"):
        wanted = [name + ending for name in joints.names]
        found.append(places(wanted) if held.issuperset(wanted) else [])
    state = JointStates(joints.ros_names, found)
    if is_as_ours:
        return state.encode
    shift, gain = np.zeros(len(contract.names)), np.ones(len(contract.names))
    shift[found[0]], gain[found[0]] = joints.offsets, 1.0 / joints.scale
    gain[found[1]] = 1.0 / joints.velocity_scale
    assert len(found[0]) == count
    return lambda numbers, ns: state.encode(((np.array(numbers) - shift) * gain).tolist(), ns)


def _imu(row: PublishRow, gyro: list[int], quat: list[int], place: dict[str, int]) -> Callable[[Any, int], bytes]:
    frame, is_down = row.frame, row.acceleration == "down"
    acceleration = [place[name] for name in _ACCELERATION if name in place]

    def imu(numbers: Any, ns: int) -> bytes:
        turned, turning = ([float(numbers[one]) for one in found] for found in (quat, gyro))
        pushed = [float(numbers[one]) for one in acceleration] or None
        if is_down:
            pushed = rotate_inverse(np.array(turned), _DOWN).tolist()
        return messages.imu(ns, frame, turned, turning, pushed)

    return imu


def _cloud(frame: str) -> Tell:
    def tell(data: bytes, written_ns: int) -> bytes | None:
        try:
            return messages.cloud(written_ns, frame, decoded(data))
        except BadCloud:
            return None

    return tell
