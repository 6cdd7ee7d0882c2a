"""State and command messages of hands as arrays. Needs only NumPy.

| hand | motors in a message | command | limp |
|---|---|---|---|
| Dex3-1 | 7 of one hand | position, stiffness, damping | no stiffness, no damping |
| RH56DFX | 6 of the right, then 6 of the left | a part of the way, 1 for open | never: it holds the last command |
| RH56DFTP | 6 of one hand | the same in thousandths | as RH56DFX |

A message is four bytes of header and a body in CDR, little endian, which pads nothing but numbers.

Source: ``idl/unitree_hg``, ``unitree_go`` of unitreerobotics/unitree_sdk2_python; ``robot_hand_unitree.py`` and
``robot_hand_inspire.py`` of unitreerobotics/xr_teleoperate; Unitree's developer page of the Dex3-1 (octet ``mode``).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from adapters.robots.hands.columns import DEX3, DFTP, DFX, Columns
from adapters.robots.legged.table import Joint
from station.protocols import Floats

_HEADER = np.frombuffer(bytes((0, 1, 0, 0)), "u1")  # CDR of version 1, little endian
_HEADER_BYTES, _PADDED_TO, _MOST_SENSORS = 4, 4, 64
_COUNTED, _OBEY = "<u4", 0x10
STOPS_BY_ITSELF = 0x80
"""Bit of a Dex3-1's octet ``mode``: the motor goes limp one second after the last command."""

_MOTOR = {"names": ["mode", "q", "dq", "tau", "kp", "kd"], "formats": ["u1", *["<f4"] * 5]}
_DEX3_MOTOR_CMD = np.dtype(_MOTOR | {"offsets": [0, 4, 8, 12, 16, 20], "itemsize": 28})  # type: ignore[call-overload]
_GO_MOTOR_CMD = np.dtype(_MOTOR | {"offsets": [0, 4, 8, 12, 16, 20], "itemsize": 36})  # type: ignore[call-overload]
_DEX3_MOTOR_STATE = np.dtype({
    "names": ["mode", "q", "dq", "ddq", "tau", "temperature", "voltage", "error"],
    "formats": ["u1", "<f4", "<f4", "<f4", "<f4", ("<i2", 2), "<f4", "<u4"],
    "offsets": [0, 4, 8, 12, 16, 20, 24, 36],
    "itemsize": 56,
})  # fmt: skip
_GO_MOTOR_STATE = np.dtype({
    "names": ["mode", "q", "dq", "tau", "temperature", "lost"],
    "formats": ["u1", "<f4", "<f4", "<f4", "u1", "<u4"],
    "offsets": [0, 4, 8, 16, 32, 36],
    "itemsize": 48,
})  # fmt: skip
_PRESSURE = np.dtype([("pressure", "<f4", 12), ("temperature", "<f4", 12), ("lost", "<u4"), ("reserve", "<u4")])
_SIX = np.dtype([("count", _COUNTED), ("values", "<i2", 6)])
_SIX_OCTETS = np.dtype([("count", _COUNTED), ("values", "u1", 6), ("pad", "u1", 2)])


def _message(fields: Sequence[tuple[Any, ...]]) -> np.dtype[Any]:
    return np.dtype([("header", "u1", _HEADER_BYTES), *fields])


DEX3_CMD = _message([("count", _COUNTED), ("motors", _DEX3_MOTOR_CMD, 7), ("reserve", "<u4", 4)])
DFX_CMD = _message([("count", _COUNTED), ("motors", _GO_MOTOR_CMD, 12)])
DFX_STATE = _message([("count", _COUNTED), ("motors", _GO_MOTOR_STATE, 12)])
DFTP_CMD = _message([(name, _SIX) for name in ("position", "angle", "force", "speed")] + [("mode", "i1")])
_DFTP_STATE = _message([
    *((name, _SIX) for name in ("position", "angle", "force", "current")),
    *((name, _SIX_OCTETS) for name in ("error", "status", "temperature")),
])  # fmt: skip
_DFTP_FIELDS = tuple(name for name in _DFTP_STATE.names or () if name != "header")
_DFTP_STATE_BYTES = _DFTP_STATE.itemsize - 2  # the last sequence is padded by nothing


@cache
def dex3_state(sensors: int) -> np.dtype[Any]:
    """Return the layout of a Dex3-1's state with so many sensors of pressure; Unitree's own have nine."""
    return _message([
        ("count", _COUNTED), ("motors", _DEX3_MOTOR_STATE, 7), ("sensors", _COUNTED), ("pressure", _PRESSURE, sensors),
        ("imu", "<f4", 13), ("imu_temperature", "<i2"), ("pad", "u1", 2), ("power", "<f4", 4), ("error", "<u4", 2),
        ("reserve", "<u4", 2),
    ])  # fmt: skip


class Measured(NamedTuple):
    """What the states of a hand say, k of them, oldest first.

    Attributes:
        rows: Shape (k, m): of all joints what the first of `HandWire.columns` says, then of all the next.
        q, dq: Positions and velocities of the newest, shape (n,) [rad, rad/s]; velocities are 0 where none come.
        error: What is wrong with a motor, in words, or "".
        pressure: Of the newest, as they come, shape (s,).
    """

    rows: NDArray[np.float64]
    q: Floats
    dq: Floats
    error: str
    pressure: NDArray[np.float64]


_NONE = np.zeros(0)
_ROOM_C = 25


class HandWire(Protocol):
    """How one kind of hand is spoken with; n joints, in the order that the station has them.

    Attributes:
        joints: The n joints.
        columns: What a state tells of each joint.
        command_topic, state_topic: Names of its topics.
        command_type, state_type: Names of their types in `adapters.robots.g1.dds.types`.
    """

    joints: tuple[Joint, ...]
    columns: Columns
    command_topic: str
    state_topic: str
    command_type: str
    state_type: str

    def measured(self, messages: Sequence[bytes]) -> Measured | None:
        """Return what states say; None where none of them is one."""
        ...

    def command(self, q: Floats, kp: Floats, kd: Floats) -> bytes:
        """Return the message that asks for positions with gains, shape (n,) each."""
        ...

    def limp(self, q: Floats) -> bytes:
        """Return the message that takes the force out of a hand that is at q, as far as it can be."""
        ...


class Dex3Wire:
    """A Dex3-1 hand (`HandWire`).

    Its motors are always told to stop by themselves a second after the last command.

    Args:
        side: ``left`` or ``right``.
        joints: In the order of the station.
        motors: Names of the joints in the order of its motors.
    """

    columns = DEX3
    command_type, state_type = "HandCmd", "HandState"

    def __init__(self, side: str, joints: tuple[Joint, ...], motors: tuple[str, ...]) -> None:
        self.joints = joints
        self.command_topic, self.state_topic = f"rt/dex3/{side}/cmd", f"rt/dex3/{side}/state"
        names = [joint.name for joint in joints]
        self._joint_of = [names.index(name) for name in motors]  # of each motor
        self._motor_of = [motors.index(name) for name in names]  # of each joint
        self._cmd = new_message(DEX3_CMD)
        self._cmd["count"] = len(motors)
        self._cmd["motors"]["mode"] = np.arange(len(motors)) | _OBEY | STOPS_BY_ITSELF

    def measured(self, messages: Sequence[bytes]) -> Measured | None:
        """Return what states say."""
        records = self._records(messages)
        if records is None:
            return None
        motors = records["motors"][:, self._motor_of]
        special = {"casing": motors["temperature"][..., 0], "winding": motors["temperature"][..., 1]}
        rows = _rows([special[name] if name in special else motors[name] for name, _, _ in self.columns])
        newest, pressure = motors[-1], records["pressure"][-1]["pressure"]
        wrong = _first_error(self.joints, newest["error"]) or (
            f"the hand reports the error {records['error'][-1].tolist()}" if records["error"][-1].any() else ""
        )
        return Measured(
            rows, newest["q"].astype(float), newest["dq"].astype(float), wrong, pressure.astype(float).ravel()
        )

    def _records(self, messages: Sequence[bytes]) -> NDArray[Any] | None:
        if not messages:
            return None
        at = _HEADER_BYTES + 4 + 7 * _DEX3_MOTOR_STATE.itemsize
        sensors = int.from_bytes(messages[-1][at : at + 4], "little")
        if sensors > _MOST_SENSORS:
            return None
        records = _parsed(messages, dex3_state(sensors))
        good = records[(records["count"] == 7) & (records["sensors"] == sensors)]
        return good if len(good) else None

    def command(self, q: Floats, kp: Floats, kd: Floats) -> bytes:
        """Return the message that asks for positions with gains."""
        motors = self._cmd["motors"][0]
        motors["q"], motors["kp"], motors["kd"] = q[self._joint_of], kp[self._joint_of], kd[self._joint_of]
        return self._cmd.tobytes()

    def limp(self, q: Floats) -> bytes:
        """Return the message without gains."""
        zeros = np.zeros(len(q))
        return self.command(q, zeros, zeros)


class DfxWire:
    """Both RH56DFX hands, which share a message (`HandWire`): joints of the left, then of the right.

    Args:
        left, right: Joints of each, in the order of its motors.
    """

    columns = DFX
    command_topic, state_topic = "rt/inspire/cmd", "rt/inspire/state"
    command_type, state_type = "MotorCmds", "MotorStates"

    def __init__(self, left: tuple[Joint, ...], right: tuple[Joint, ...]) -> None:
        self.joints = (*left, *right)
        self._scale = _Scale(self.joints)
        self._order = [*range(6, 12), *range(6)]  # of motors, and of joints: the right hand comes first
        self._cmd = new_message(DFX_CMD)
        self._cmd["count"] = len(self.joints)

    def measured(self, messages: Sequence[bytes]) -> Measured | None:
        """Return what states say."""
        records = _parsed(messages, DFX_STATE)
        records = records[records["count"] == len(self.joints)]
        if not len(records):
            return None
        motors = records["motors"][:, self._order]
        q = self._scale.angles(motors["q"])
        return Measured(_rows([q, *(motors[name] for name, _, _ in self.columns[1:])]), q[-1], np.zeros(12), "", _NONE)

    def command(self, q: Floats, kp: Floats, kd: Floats) -> bytes:
        """Return the message that asks for positions; it has no gains."""
        self._cmd["motors"]["q"][0] = self._scale.parts(q)[self._order]
        return self._cmd.tobytes()

    def limp(self, q: Floats) -> bytes:
        """Return the message that asks it to stay."""
        return self.command(q, _NONE, _NONE)

    def told(self, message: bytes) -> Floats | None:
        """Return the positions that a command asks for, shape (12,) [rad]; None for what is no command."""
        records = _parsed([message], DFX_CMD)
        q = records["motors"]["q"][:, self._order]
        is_one = len(records) == 1 and records["count"][0] == len(self.joints) and np.isfinite(q).all()
        return self._scale.angles(np.clip(q[0], 0.0, 1.0)) if is_one else None

    def state(self, q: Floats, errors: Sequence[int]) -> bytes:
        """Return a state; it has no place for errors."""
        record = new_message(DFX_STATE)
        record["count"] = len(self.joints)
        record["motors"]["q"][0] = self._scale.parts(q)[self._order]
        record["motors"]["temperature"] = _ROOM_C
        return record.tobytes()


class DftpWire:
    """An RH56DFTP hand (`HandWire`), behind Inspire's own bridge from Modbus to DDS.

    Args:
        side: ``left`` or ``right``.
        joints: In the order of its motors.
    """

    columns = DFTP
    command_type, state_type = "InspireCtrl", "InspireState"
    _BY_ANGLE, _WHOLE = 1, 1000.0

    def __init__(self, side: str, joints: tuple[Joint, ...]) -> None:
        self.joints = joints
        self.command_topic, self.state_topic = (f"rt/inspire_hand/{what}/{side[0]}" for what in ("ctrl", "state"))
        self._scale = _Scale(joints)
        self._cmd = new_message(DFTP_CMD)
        for name in ("position", "angle", "force", "speed"):
            self._cmd[name]["count"] = len(joints)
        self._cmd["mode"] = self._BY_ANGLE

    def measured(self, messages: Sequence[bytes]) -> Measured | None:
        """Return what states say."""
        records = _parsed([message + b"\0\0" for message in messages], _DFTP_STATE)  # its end may not be padded
        counts = [records[name]["count"] == len(self.joints) for name in _DFTP_FIELDS]
        records = records[np.logical_and.reduce(counts)]
        if not len(records):
            return None
        q = self._scale.angles(records["angle"]["values"] / self._WHOLE)
        rows = _rows([q, *(records[name]["values"] for name, _, _ in self.columns[1:])])
        return Measured(rows, q[-1], np.zeros(6), _first_error(self.joints, records["error"]["values"][-1]), _NONE)

    def command(self, q: Floats, kp: Floats, kd: Floats) -> bytes:
        """Return the message that asks for positions; it has no gains."""
        self._cmd["angle"]["values"][0] = np.rint(self._scale.parts(q) * self._WHOLE)
        return self._cmd.tobytes()

    def limp(self, q: Floats) -> bytes:
        """Return the message that asks it to stay."""
        return self.command(q, _NONE, _NONE)

    def told(self, message: bytes) -> Floats | None:
        """Return the positions that a command asks for, shape (6,) [rad]; None for what is no command by angle."""
        records = _parsed([message], DFTP_CMD)
        if (
            len(records) != 1
            or records["angle"]["count"][0] != len(self.joints)
            or records["mode"][0] != self._BY_ANGLE
        ):
            return None
        return self._scale.angles(np.clip(records["angle"]["values"][0], 0, self._WHOLE) / self._WHOLE)

    def state(self, q: Floats, errors: Sequence[int]) -> bytes:
        """Return a state."""
        record = new_message(_DFTP_STATE)
        for name in _DFTP_FIELDS:
            record[name]["count"] = len(self.joints)
        record["angle"]["values"] = record["position"]["values"] = np.rint(self._scale.parts(q) * self._WHOLE)
        record["error"]["values"], record["temperature"]["values"] = errors, _ROOM_C
        return record.tobytes()[:_DFTP_STATE_BYTES]


class _Scale:
    """Between angles [rad] and parts of the way from closed, 0, to open, 1."""

    def __init__(self, joints: tuple[Joint, ...]) -> None:
        self._upper = np.array([joint.upper for joint in joints])
        self._span = self._upper - np.array([joint.lower for joint in joints])

    def angles(self, parts: NDArray[Any]) -> Floats:
        return np.asarray(self._upper - parts.astype(float) * self._span)

    def parts(self, angles: Floats) -> Floats:
        return np.asarray(np.clip((self._upper - angles) / self._span, 0.0, 1.0))


def new_message(kind: np.dtype[Any]) -> NDArray[Any]:
    """Return a message of zeros in a layout, shape (1,)."""
    record = np.zeros(1, kind)
    record["header"] = _HEADER
    return record


def _parsed(messages: Sequence[bytes], kind: np.dtype[Any]) -> NDArray[Any]:
    """Return the messages that are as long as a layout, and little endian, as records of it; DDS pads to four bytes."""
    size = kind.itemsize
    whole = [m[:size] for m in messages if size <= len(m) < size + _PADDED_TO and m[:2] == b"\0\1"]
    return np.frombuffer(b"".join(whole), kind)


def _rows(columns: Sequence[NDArray[Any]]) -> NDArray[np.float64]:
    """Return columns of shape (k, n) each as rows."""
    return np.concatenate(columns, axis=1, dtype=np.float64)


def _first_error(joints: tuple[Joint, ...], errors: NDArray[Any]) -> str:
    wrong = np.flatnonzero(errors)
    return f"motor {joints[wrong[0]].name} reports the error 0x{int(errors[wrong[0]]):x}" if len(wrong) else ""
