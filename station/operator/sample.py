"""One sample of an operator's device, and how it stands on the bus.

Every number is SI, in the operator's world: x forward, y left, z up; quaternions are ``w x y z``. Where its origin is
depends on the device (a headset's is where the head was when its app started), so only differences mean something
before an operator is calibrated. Devices are converted once, by their adapter.

**On the bus** a new sample is one atomic write: a key per part that it has, beside the status, with the device's own
time of capture in the stamps. A tick without a new sample writes the status alone: what a sample held is never written
a second time. A part that a sample lacks (a body that is tracked no more) leaves its key as it was, so the status lists
the parts of the newest sample, and `decode` gives no others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import msgspec
import numpy as np

from station.bus import codec, keys
from station.bus.joints import HAND_26, SMPL_24
from station.bus.sample import Sample
from station.protocols import Floats

Side = Literal["left", "right"]
State = Literal["live", "stale", "lost"]
Part = Literal[
    "controls", "head", "left", "right", "body_pos", "body_quat", "hand_left", "hand_right", "twist", "joints"
]  # fmt: skip

_MOST_CONTROLS = 256
_UNIT_TOLERANCE = 1e-3  # of a quaternion's length
_LARGEST = 1e4  # [m], [rad] or of an axis: no operator is farther away, and the square of 1e200 is infinite


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A place and an orientation in the operator's world.

    Attributes:
        position: Shape (3,) [m].
        quat_wxyz: Shape (4,), of unit length.
    """

    position: Floats
    quat_wxyz: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """The operator's body, joints in the order of `station.bus.joints.SMPL_24`.

    Attributes:
        positions: Shape (24, 3) [m].
        quats_wxyz: Orientations in the world, not in the parent's frame, shape (24, 4), of unit length.
    """

    positions: Floats
    quats_wxyz: Floats


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OperatorSample:
    """One sample of a device; what it does not have is None or empty.

    Attributes:
        capture_ns: When it was captured, on the device's clock [ns]; None where the device tells no time.
        controls: Axes from -1 to 1, triggers from 0 to 1, buttons 0 or 1, by name. Of a pair of controllers:
            ``left_trigger left_grip left_stick_x left_stick_y left_stick_click left_primary left_secondary left_menu``
            and the same on the right; primary is X and A, secondary Y and B. Stick x is positive to the right, y
            forward.
        head, left, right: Headset, and what the hands hold.
        body: The whole body.
        hands: Poses of the joints of `station.bus.joints.HAND_26` by side, shape (26, 7): x y z qw qx qy qz.
        twist: Deflection of a six-axis device, shape (6,): vx vy vz wx wy wz, each -1 to 1.
        joints: Leader joints [rad], and its gripper from 0 to 1 where it has one, shape (n,).
    """

    capture_ns: int | None = None
    controls: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    head: Pose | None = None
    left: Pose | None = None
    right: Pose | None = None
    body: Body | None = None
    hands: Mapping[Side, Floats] = field(default_factory=lambda: MappingProxyType({}))
    twist: Floats | None = None
    joints: Floats | None = None


class Status(msgspec.Struct, frozen=True, kw_only=True):
    """What a device server says of its device with every tick.

    Attributes:
        state: ``live``; ``stale`` when no new sample came for a moment, ``lost`` when none came for long.
        reason: Why it is not live; "" when it is.
        capture_ns: Of the newest sample, on the device's clock [ns].
        new: Number of samples since the server started; it moves on only with a new one.
        repeated: Number of ticks that had no new sample.
        parts: What the newest sample holds.
    """

    state: State
    reason: str = ""
    capture_ns: int | None = None
    new: int = 0
    repeated: int = 0
    parts: tuple[Part, ...] = ()


_KEYS: dict[Part, Callable[[str], str]] = {
    "controls": keys.operator_controls,
    "head": keys.operator_head,
    "left": keys.operator_left,
    "right": keys.operator_right,
    "body_pos": keys.operator_body_pos,
    "body_quat": keys.operator_body_quat,
    "hand_left": keys.operator_hand_left,
    "hand_right": keys.operator_hand_right,
    "twist": keys.operator_twist,
    "joints": keys.operator_joints,
}
_ANY_LENGTH = (-1,)
_SHAPES: dict[Part, tuple[int, ...]] = {
    "head": (7,),
    "left": (7,),
    "right": (7,),
    "body_pos": (len(SMPL_24), 3),
    "body_quat": (len(SMPL_24), 4),
    "hand_left": (len(HAND_26), 7),
    "hand_right": (len(HAND_26), 7),
    "twist": (6,),
    "joints": _ANY_LENGTH,
}


def watched_keys(device: str) -> tuple[str, ...]:
    """Return every key that a device server of a name may write, its status first."""
    return (keys.operator_status(device), *(spell(device) for spell in _KEYS.values()))


def encode(device: str, reading: OperatorSample) -> dict[str, bytes]:
    """Return the values of a sample by key; what it does not have has no key.

    Raises:
        ValueError: a part has another shape than its docstring says.
    """
    found = {_KEYS[part](device): _encoded(part, array) for part, array in _arrays(reading).items()}
    if reading.controls:
        found[keys.operator_controls(device)] = codec.json_object(dict(reading.controls))
    return found


def parts(reading: OperatorSample) -> tuple[Part, ...]:
    """Return the names of what a sample has."""
    return (*(("controls",) if reading.controls else ()), *_arrays(reading))


def encode_status(device: str, status: Status) -> dict[str, bytes]:
    """Return the value of the status by key."""
    return {keys.operator_status(device): codec.json_object(status)}


def decode(device: str, samples: Mapping[str, Sample]) -> OperatorSample:
    """Return the newest sample of a device from what a watch holds of `watched_keys`; an empty one without a status.

    Says nothing of its age: the status does, and the age of the status itself (a device server may be dead).

    Raises:
        codec.BadValue: a value is not what its contract says; the message names the key.
    """
    status = decode_status(device, samples)
    if status is None:
        return OperatorSample()
    arrays: dict[Part, Floats] = {}
    for part in status.parts:
        sample = samples.get(_KEYS[part](device))
        if sample is not None and part != "controls":
            arrays[part] = _decoded(part, sample)
    controls = samples.get(keys.operator_controls(device)) if "controls" in status.parts else None
    hands: dict[Side, Floats] = {}
    if "hand_left" in arrays:
        hands["left"] = arrays["hand_left"]
    if "hand_right" in arrays:
        hands["right"] = arrays["hand_right"]
    return OperatorSample(
        capture_ns=status.capture_ns,
        controls=_decoded_controls(controls) if controls is not None else MappingProxyType({}),
        head=_pose(arrays.get("head")),
        left=_pose(arrays.get("left")),
        right=_pose(arrays.get("right")),
        body=_body(arrays),
        hands=hands,
        twist=arrays.get("twist"),
        joints=arrays.get("joints"),
    )


def decode_status(device: str, samples: Mapping[str, Sample]) -> Status | None:
    """Return what a device server last said; None when it never spoke.

    Raises:
        codec.BadValue: it is no status; the message names the key.
    """
    sample = samples.get(keys.operator_status(device))
    if sample is None:
        return None
    try:
        return codec.parse_struct(sample.value, Status)
    except codec.BadValue as error:
        raise codec.BadValue(f"{sample.key}: {error}") from error


def _arrays(reading: OperatorSample) -> dict[Part, Floats]:
    found: dict[Part, Floats] = {}
    if reading.head is not None:
        found["head"] = _flat(reading.head)
    if reading.left is not None:
        found["left"] = _flat(reading.left)
    if reading.right is not None:
        found["right"] = _flat(reading.right)
    if reading.body is not None:
        found["body_pos"], found["body_quat"] = reading.body.positions, reading.body.quats_wxyz
    if "left" in reading.hands:
        found["hand_left"] = reading.hands["left"]
    if "right" in reading.hands:
        found["hand_right"] = reading.hands["right"]
    if reading.twist is not None:
        found["twist"] = reading.twist
    if reading.joints is not None:
        found["joints"] = reading.joints
    return found


def _flat(pose: Pose) -> Floats:
    return np.concatenate([pose.position, pose.quat_wxyz])


def _encoded(part: Part, array: Floats) -> bytes:
    shape = _SHAPES[part]
    fits = array.shape == shape or (shape == _ANY_LENGTH and array.ndim == 1)
    if not fits:
        raise ValueError(f"{part} has shape {array.shape}, expected {shape}")
    return codec.f64(array)


def _decoded(part: Part, sample: Sample) -> Floats:
    try:
        values = codec.parse_f64(sample.value)
    except codec.BadValue as error:
        raise codec.BadValue(f"{sample.key}: {error}") from error
    shape = _SHAPES[part]
    count = int(np.prod(shape))
    if count > 0 and len(values) != count:
        raise codec.BadValue(f"{sample.key}: {len(values)} values, expected {count}")
    if not (np.abs(values) <= _LARGEST).all():
        raise codec.BadValue(f"{sample.key}: not finite, or beyond {_LARGEST:g}")
    array = values.reshape(shape)
    if shape[-1] in (4, 7) and (np.abs(np.linalg.norm(array[..., -4:], axis=-1) - 1.0) > _UNIT_TOLERANCE).any():
        raise codec.BadValue(f"{sample.key}: a quaternion is not of unit length")
    return array


def _decoded_controls(sample: Sample) -> dict[str, float]:
    try:
        controls = codec.parse_struct(sample.value, dict[str, float])
    except codec.BadValue as error:
        raise codec.BadValue(f"{sample.key}: {error}") from error
    if len(controls) > _MOST_CONTROLS:
        raise codec.BadValue(f"{sample.key}: {len(controls)} controls, expected at most {_MOST_CONTROLS}")
    if not all(abs(value) <= _LARGEST for value in controls.values()):
        raise codec.BadValue(f"{sample.key}: a control is beyond {_LARGEST:g}")
    return controls


def _pose(array: Floats | None) -> Pose | None:
    return None if array is None else Pose(array[:3], array[3:])


def _body(arrays: Mapping[Part, Floats]) -> Body | None:
    if "body_pos" not in arrays or "body_quat" not in arrays:
        return None
    return Body(arrays["body_pos"], arrays["body_quat"])
