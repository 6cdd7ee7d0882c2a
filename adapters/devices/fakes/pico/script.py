"""The script of a fake headset, a JSON file; what it may hold is told in `adapters.devices.fakes.pico`.

The fake of a headset's page (`adapters.devices.fakes.webxr`) plays such scripts too.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Literal

import msgspec

from adapters.devices.fakes.script import file_of
from adapters.devices.pico.controls import CONTROLS, RANGES
from adapters.devices.webxr.controls import TOUCH_HOLD
from station.bus.joints import HAND_26, SMPL_24
from station.errors import BadFile, did_you_mean

Numbers = list[float]
Ranges = dict[str, tuple[float, float]]
FaultKind = Literal["silence", "freeze", "crash", "jump", "no-body", "no-controllers", "torn", "poison"]

_MOST_BYTES = 256 << 20  # ten minutes of a whole body at 72 Hz are about 150 MB
_RANGES = {name: RANGES[control.kind] for name, control in CONTROLS.items()}
_RANGES_OF = {"pico": _RANGES, "webxr": {**_RANGES, TOUCH_HOLD: (0.0, 1.0)}}  # by device, of each control
_LENGTHS = {"head": 7, "left": 7, "right": 7}


class Skeleton(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A body in a frame of the script: positions (24, 3) [m] and quaternions wxyz (24, 4), FLU."""

    positions: list[Numbers]
    quats_wxyz: list[Numbers]


class Hands(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Tracked hands in a frame of the script, each (26, 7): x y z [m] qw qx qy qz, FLU."""

    left: list[Numbers] | None = None
    right: list[Numbers] | None = None


class KeyFrame(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What is where at one time: poses are x y z [m] qw qx qy qz, FLU."""

    at_s: float
    head: Numbers | None = None
    left: Numbers | None = None
    right: Numbers | None = None
    body: Skeleton | None = None
    hands: Hands | None = None
    controls: dict[str, float] = {}


class Control(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A button that is pressed (released after `for_s`), or values that are set (back to rest after `for_s`)."""

    at_s: float
    press: str = ""
    set: dict[str, float] = {}
    for_s: float | None = None


class Fault(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Something that goes wrong, from `at_s` on, for `for_s` [s]."""

    at_s: float
    kind: FaultKind
    for_s: float | None = None
    by_m: tuple[float, ...] = (0.5, 0.0, 0.0)
    turn_deg: float = 0.0


class Script(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a fake headset plays."""

    device: Literal["pico", "webxr"] = "pico"
    rate_hz: float = 72.0
    motion: str = ""
    height_m: float | None = None
    repeat: Literal["once", "swing"] = "once"
    frames: list[KeyFrame] = []
    between: Literal["blend", "hold"] = "blend"
    origin: Literal["head", "floor"] = "head"
    controls: list[Control] = []
    faults: list[Fault] = []


def load(path: Path, device: Literal["pico", "webxr"] = "pico") -> Script:
    """Read a script for a device: a file, or ``collection:path`` (``builtin:pico/example.json``).

    Raises:
        AssetMissing: the collection has no such file.
        BadFile: missing, not JSON, or a field that is unknown or wrong; the message names file and field.
    """
    path = file_of(path)
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise BadFile(f"{path}: larger than {_MOST_BYTES >> 20} MB; expected the script of a fake headset")
        data = path.read_bytes()
    except OSError as error:
        near = did_you_mean(path.name, [p.name for p in path.parent.glob("*.json")]) if path.parent.is_dir() else ""
        raise BadFile(
            f"{path}: cannot be read: {error.strerror}{near}; expected the script of a fake headset"
        ) from None
    try:
        script = msgspec.json.decode(data, type=Script)
        if script.device != device:
            raise _Wrong("device", f"expected '{device}', got '{script.device}'")
        _check(script)
    except (msgspec.ValidationError, _Wrong) as error:
        raise BadFile(f"{path}: {_plain(str(error))}") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadFile(f"{path}: not JSON: {error}; expected the script of a fake headset") from None
    return script


class _Wrong(ValueError):
    """What is wrong with a field, as msgspec says it: ``... - at `$.field` ``."""

    def __init__(self, place: str, text: str) -> None:
        super().__init__(f"{text} - at `$.{place}`")


def _plain(text: str) -> str:
    """Turn "Object contains unknown field `x` - at `$.faults[0]`" into "faults[0]: unknown field 'x'"."""
    what, _, place = text.partition(" - at `$")
    what = re.sub(r"^Object (contains )?", "", what).replace("`", "'")
    what = what[:1].lower() + what[1:]
    unknown = re.search(r"unknown field '(.*)'", what)
    if unknown:
        what += did_you_mean(unknown[1], sorted(name for kind in _KINDS for name in kind.__struct_fields__))
    place = place.rstrip("`").lstrip(".")
    return f"{place}: {what}" if place else what


_KINDS: tuple[Any, ...] = (Script, KeyFrame, Control, Fault, Skeleton, Hands)


def _check(script: Script) -> None:
    if not 1.0 <= script.rate_hz <= 1000.0:
        raise _Wrong("rate_hz", f"expected 1 to 1000 Hz, got {script.rate_hz:g}; a headset sends 72 or 90")
    if script.height_m is not None and not 0.5 <= script.height_m <= 2.5:
        raise _Wrong("height_m", f"expected 0.5 to 2.5 m, got {script.height_m:g}")
    if script.motion and script.frames:
        raise _Wrong("frames", "expected either a motion or frames, got both")
    ranges = _RANGES_OF[script.device]
    for index, frame in enumerate(script.frames):
        _check_frame(frame, ranges, f"frames[{index}]")
        if index and frame.at_s <= script.frames[index - 1].at_s:
            raise _Wrong(
                f"frames[{index}].at_s", f"expected more than {script.frames[index - 1].at_s:g}, got {frame.at_s:g}"
            )
    for index, control in enumerate(script.controls):
        _check_control(control, ranges, f"controls[{index}]")
    for index, fault in enumerate(script.faults):
        _check_times(fault.at_s, fault.for_s, f"faults[{index}]")
        if len(fault.by_m) != 3:
            raise _Wrong(f"faults[{index}].by_m", f"expected 3 numbers [m], got {len(fault.by_m)}")


def _check_frame(frame: KeyFrame, ranges: Ranges, place: str) -> None:
    for name, length in _LENGTHS.items():
        _check_rows([getattr(frame, name)], 1, length, f"{place}.{name}")
    if frame.body is not None:
        _check_rows(frame.body.positions, len(SMPL_24), 3, f"{place}.body.positions")
        _check_rows(frame.body.quats_wxyz, len(SMPL_24), 4, f"{place}.body.quats_wxyz")
    if frame.hands is not None:
        for side in ("left", "right"):
            if (hand := getattr(frame.hands, side)) is not None:
                _check_rows(hand, len(HAND_26), 7, f"{place}.hands.{side}")
    _check_values(frame.controls, ranges, f"{place}.controls")


def _check_rows(rows: list[Any], count: int, length: int, place: str) -> None:
    if len(rows) != count:
        raise _Wrong(place, f"expected {count} rows of {length} numbers, got {len(rows)}")
    for row in rows:
        if row is None:
            continue
        if len(row) != length:
            raise _Wrong(place, f"expected {length} numbers, got {len(row)}")
        if length in (4, 7) and abs(sum(value * value for value in row[-4:]) - 1.0) > 1e-2:
            raise _Wrong(place, "expected a quaternion w x y z of length 1 at the end")


def _check_control(control: Control, ranges: Ranges, place: str) -> None:
    _check_times(control.at_s, control.for_s, place)
    if bool(control.press) == bool(control.set):
        raise _Wrong(place, "expected either press or set")
    _check_values({control.press: 1.0} if control.press else control.set, ranges, place)


def _check_values(values: dict[str, float], ranges: Ranges, place: str) -> None:
    for name, value in values.items():
        if name not in ranges:
            raise _Wrong(place, f"no control '{name}'{did_you_mean(name, ranges)}; known: {', '.join(ranges)}")
        low, high = ranges[name]
        if not low <= value <= high:
            raise _Wrong(place, f"{name}: expected {low:g} to {high:g}, got {value:g}")


def _check_times(at_s: float, for_s: float | None, place: str) -> None:
    if at_s < 0.0:
        raise _Wrong(f"{place}.at_s", f"expected seconds from the start, got {at_s:g}")
    if for_s is not None and for_s <= 0.0:
        raise _Wrong(f"{place}.for_s", f"expected more than 0 s, got {for_s:g}")
