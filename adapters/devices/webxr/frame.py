"""A frame of the page: what WebXR says of a headset, hands and controllers at one time, and the sample that it makes.

One binary message of `FRAME`, little-endian, as WebXR has it: x right, y up, z back [m], quaternions ``x y z w``, the
floor below the operator at the origin. Source of the spaces and of the order of buttons, axes and joints: W3C, WebXR
Device API, WebXR Gamepads Module (``xr-standard``), WebXR Hand Input Module.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from adapters.devices.webxr.body import JOINTS as BODY
from adapters.devices.webxr.body import body_of
from adapters.devices.webxr.controls import OF_A_SIDE, SENT, TOUCH_HOLD
from adapters.retarget import frames
from station import rotations
from station.bus.joints import HAND_26
from station.operator.sample import OperatorSample, Pose, Side
from station.protocols import Floats

JOINTS = len(HAND_26) - 1
"""WebXR has a hand's joints in OpenXR's order, without the palm."""

FRAME = np.dtype([
    ("magic", "<u4"),
    ("parts", "<u4"),  # bits of `PARTS`: what this frame has
    ("taken_ms", "<f8"),  # of the animation frame, on the page's clock
    ("sent_ms", "<f8"),  # when it left the page, on that clock
    ("head", "<f4", (7,)), ("left", "<f4", (7,)), ("right", "<f4", (7,)),
    ("controls", "<f4", (len(SENT) + 1,)),  # in that order, then `TOUCH_HOLD`
    ("hand_left", "<f4", (JOINTS, 7)), ("hand_right", "<f4", (JOINTS, 7)),
    ("body", "<f4", (len(BODY), 3)),
])  # fmt: skip
MAGIC = 0x31525853  # "SXR1"
PARTS = {name: 1 << bit for bit, name in enumerate(
    ("head", "left", "right", "controls_left", "controls_right", "hand_left", "hand_right", "touch", "body")
)}  # fmt: skip

_FARTHEST_M = 100.0
_UNIT_TOLERANCE = 0.01  # of a quaternion's length
_OPEN_M, _CLOSED_M = 0.045, 0.015  # between the tips of thumb and index finger
_THUMB_TIP, _INDEX_TIP, _METACARPAL, _KNUCKLE = 4, 9, 10, 11  # of a hand's joints here
_SIDES: tuple[Side, ...] = ("left", "right")

Palms = Mapping[Side, Pose]
"""The palm in the frame of what a hand holds (WebXR's grip space), by side."""


def mirrored(palm: Pose) -> Pose:
    """Return the palm of a left hand for that of a right one."""
    x, y, z = palm.position
    qw, qx, qy, qz = palm.quat_wxyz
    return Pose(np.array([x, -y, z]), np.array([qw, -qx, qy, -qz]))


class BadFrame(ValueError):
    """A message that is no frame; one line."""


def parse(data: bytes) -> np.void:
    """Return a frame.

    Raises:
        BadFrame: it is none, or holds what is no number.
    """
    if len(data) != FRAME.itemsize:
        raise BadFrame(f"{len(data)} bytes, expected {FRAME.itemsize}")
    frame: np.void = np.frombuffer(data, FRAME)[0]
    if frame["magic"] != MAGIC:
        raise BadFrame(f"begins with {int(frame['magic']):#x}, expected {MAGIC:#x}")
    if not np.isfinite([frame["taken_ms"], frame["sent_ms"]]).all():
        raise BadFrame("its times are no numbers")
    return frame


def sample_of(frame: np.void, capture_ns: int, palms: Palms, touch_scale: float = 1.0) -> OperatorSample:
    """Return the sample that a frame makes, in the operator's world.

    Args:
        frame: Of `parse`.
        capture_ns: When it was taken, on this machine's clock [ns].
        palms: Where the palm is in what a hand holds; a side that is not there has it where WebXR has the grip.
        touch_scale: What the sticks of a touch screen are multiplied by.

    Raises:
        BadFrame: a pose is no pose, or a control no number.
    """
    has = {name for name, bit in PARTS.items() if int(frame["parts"]) & bit}
    poses: dict[str, Floats] = {name: _poses(frame, name)[0] for name in ("head", "left", "right") if name in has}
    controls = _controls(frame, has, touch_scale)
    hands: dict[Side, Floats] = {}
    held: dict[Side, Pose] = {}
    for side in _SIDES:
        if f"hand_{side}" in has:
            hands[side] = _with_palm(_poses(frame, f"hand_{side}"))
            held[side] = _pose(hands[side][0])
            controls[f"{side}_pinch"] = _pinch(hands[side][1:])
        elif side in poses:
            held[side] = _at_palm(_pose(poses[side]), palms.get(side))
    return OperatorSample(
        capture_ns=capture_ns, controls=controls, head=_pose(poses["head"]) if "head" in poses else None,
        left=held.get("left"), right=held.get("right"), hands=hands,
        body=body_of(_places(frame)) if "body" in has else None,
    )  # fmt: skip


def _poses(frame: np.void, name: str) -> Floats:
    """Return poses of a frame in our world, shape (n, 7): x y z [m] qw qx qy qz."""
    rows = frame[name].astype(np.float64).reshape(-1, 7)
    lengths = np.linalg.norm(rows[:, 3:], axis=-1)
    if not (np.isfinite(rows).all() and (np.abs(rows[:, :3]) <= _FARTHEST_M).all()):
        raise BadFrame(f"{name}: no number, or beyond {_FARTHEST_M:g} m")
    if (np.abs(lengths - 1.0) > _UNIT_TOLERANCE).any():
        raise BadFrame(f"{name}: a quaternion is not of unit length")
    quats = frames.quats_to_flu(rotations.normalized(frames.wxyz(rows[:, 3:])))
    return np.concatenate([frames.positions_to_flu(rows[:, :3]), quats], axis=-1)


def _places(frame: np.void) -> Floats:
    """Return where the joints of the body are in our world, shape (n, 3) [m]."""
    rows = frame["body"].astype(np.float64)
    if not (np.isfinite(rows).all() and (np.abs(rows) <= _FARTHEST_M).all()):
        raise BadFrame(f"body: no number, or beyond {_FARTHEST_M:g} m")
    return frames.positions_to_flu(rows)


def _controls(frame: np.void, has: set[str], touch_scale: float) -> dict[str, float]:
    found: dict[str, float] = {}
    values: list[float] = frame["controls"].tolist()
    for number, name in enumerate(SENT):
        side = _SIDES[number // len(OF_A_SIDE)]
        if f"controls_{side}" not in has:
            continue
        value = (
            0.0 - values[number] if name.endswith("stick_y") else values[number]
        )  # a gamepad's y is towards the person
        if not abs(value) <= 1.0:
            raise BadFrame(f"{name}: {value:g}, expected -1 to 1")
        is_slow = "touch" in has and name.endswith(("stick_x", "stick_y"))
        found[name] = value * touch_scale if is_slow else value
    if "touch" in has:
        found[TOUCH_HOLD] = 1.0 if values[-1] > 0.5 else 0.0
    return found


def _with_palm(joints: Floats) -> Floats:
    """Return a hand in OpenXR's joints, its palm first: the middle of the middle finger's metacarpal bone."""
    palm = joints[_METACARPAL].copy()
    palm[:3] = (joints[_METACARPAL, :3] + joints[_KNUCKLE, :3]) / 2.0
    return np.concatenate([palm[np.newaxis], joints])


def _pinch(joints: Floats) -> float:
    apart_m = float(np.linalg.norm(joints[_THUMB_TIP, :3] - joints[_INDEX_TIP, :3]))
    return float(np.clip((_OPEN_M - apart_m) / (_OPEN_M - _CLOSED_M), 0.0, 1.0))


def _at_palm(grip: Pose, palm: Pose | None) -> Pose:
    if palm is None:
        return grip
    return Pose(
        grip.position + rotations.rotate(grip.quat_wxyz, palm.position),
        rotations.multiply(grip.quat_wxyz, palm.quat_wxyz),
    )


def _pose(row: Floats) -> Pose:
    return Pose(row[:3], row[3:])


def packed(**values: Any) -> bytes:
    """Return a frame as the page sends it, from what it has by the names of `FRAME`; for tests and the fake."""
    frame = np.zeros(1, FRAME)
    frame["magic"] = MAGIC
    for name, value in values.items():
        frame[name] = value
    return frame.tobytes()
