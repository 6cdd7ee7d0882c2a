"""TWIST2's ``data.json``: read, and its shape checked, before it is used; the file may come from anywhere."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from adapters.robots.g1 import twist_keys
from station.errors import BadFile

NAME = "data.json"
VECTORS = {
    "state_body": twist_keys.state_body(twist_keys.TWIST2_ROBOT),
    "state_hand_left": twist_keys.state_hand("left"),
    "state_hand_right": twist_keys.state_hand("right"),
    "state_neck": twist_keys.state_neck(),
    "action_body": twist_keys.action_body(),
    "action_hand_left": twist_keys.action_hand("left"),
    "action_hand_right": twist_keys.action_hand("right"),
    "action_neck": twist_keys.action_neck(),
}
"""Fields that hold lists of numbers, and the keys that the recorder read them from."""

T_IMAGE = "t_img"
TIMES = (T_IMAGE, twist_keys.T_ACTION, twist_keys.T_STATE)
"""Fields that hold a wall clock, milliseconds since the epoch."""

PICTURE, INDEX = "rgb", "idx"

_LARGEST = 1 << 30  # bytes; an hour of the stock recorder is about a third of it
_LARGEST_PICTURE = 64 << 20
_MOST_OTHERS = 64
_LATEST_MS = (1 << 63) // 1_000_000


@dataclass(frozen=True)
class Document:
    """A file that has the right shape.

    Attributes:
        sha256: Of its bytes.
        info, text: What it says of itself.
        data: Its entries, one per tick of the recorder.
        others: Fields of entries that are none of the stock recorder's.
    """

    sha256: str
    info: Mapping[str, Any]
    text: Any
    data: Sequence[Mapping[str, Any]]
    others: Sequence[str]


def load(folder: Path) -> Document:
    """Read the file of a recording.

    Raises:
        BadFile: it is missing, or not what TWIST2's recorder writes; names file and field.
    """
    file = folder / NAME
    raw = _read(file)
    try:
        document = json.loads(raw)
    except json.JSONDecodeError as error:
        raise BadFile(f"{file}: not JSON: {error.msg} in line {error.lineno}, column {error.colno}") from None
    except (ValueError, RecursionError) as error:  # not UTF-8, numbers of thousands of digits, brackets without end
        raise BadFile(f"{file}: not JSON that can be read: {error}") from None
    if not isinstance(document, dict):
        raise _wrong(file, "", "an object with info, text and data", document)
    info, data = document.get("info") or {}, document.get("data")
    if not isinstance(info, dict):
        raise _wrong(file, "info", "an object", info)
    if not isinstance(data, list):
        raise _wrong(file, "data", "a list of entries", data)
    if not data:
        raise BadFile(f"{file}: data: holds no entry: the recording was stopped before its first tick")
    others: dict[str, None] = {}
    for number, entry in enumerate(data):
        if not isinstance(entry, dict):
            raise _wrong(file, f"data[{number}]", "an object", entry)
        others.update(dict.fromkeys(_check(file, number, entry)))
    if len(others) > _MOST_OTHERS:
        raise BadFile(f"{file}: data: {len(others)} fields that the stock recorder does not write, expected few")
    return Document(hashlib.sha256(raw).hexdigest(), info, document.get("text"), data, list(others))


def picture(folder: Path, number: int, name: str) -> bytes:
    """Return the picture that an entry names, byte for byte.

    Raises:
        BadFile: it is missing, lies outside the folder, or is no whole JPEG file.
    """
    where = f"{folder / NAME}: data[{number}].{PICTURE}"
    try:
        path, base = (folder / name).resolve(), folder.resolve()
        if not path.is_relative_to(base):
            raise BadFile(f"{where}: {name!r} leads out of the recording's folder")
        if not path.is_file():
            raise BadFile(f"{where}: {name!r} is not there")
        if path.stat().st_size > _LARGEST_PICTURE:
            raise BadFile(f"{where}: {name!r} has {path.stat().st_size} bytes, too many for a picture")
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        raise BadFile(f"{where}: {name!r} cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if not data.startswith(b"\xff\xd8\xff"):
        raise BadFile(f"{where}: {name!r} is no JPEG file (it begins with {data[:4].hex() or 'nothing'})")
    if not data.rstrip(b"\0").endswith(b"\xff\xd9"):
        raise BadFile(f"{where}: {name!r} is cut off: a JPEG file without its end")
    return data


def _read(file: Path) -> bytes:
    try:
        size = os.stat(file).st_size
        if size > _LARGEST:
            raise BadFile(f"{file}: {size} bytes, expected at most {_LARGEST}")
        return file.read_bytes()
    except FileNotFoundError:
        raise BadFile(
            f"{file}: not there: TWIST2's recorder writes it as an episode ends, so one that was killed left only "
            "pictures, and no numbers to import"
        ) from None
    except OSError as error:
        raise BadFile(f"{file}: cannot be read: {error.strerror}") from None


def _check(file: Path, number: int, entry: Mapping[str, Any]) -> Iterator[str]:
    """Refuse values of the wrong shape; yield the fields that are not known."""
    for name, value in entry.items():
        if value is None:
            continue
        place = f"data[{number}].{name}"
        if name in VECTORS:
            if not isinstance(value, list) or not all(map(_is_number, value)):
                raise _wrong(file, place, "a list of numbers or null", value)
        elif name in TIMES:
            if not _is_whole(value) or not 0 <= value < _LATEST_MS:
                raise _wrong(file, place, "milliseconds since the epoch or null", value)
        elif name == INDEX:
            if not _is_whole(value):
                raise _wrong(file, place, "a whole number", value)
        elif name == PICTURE:
            if not isinstance(value, str):
                raise _wrong(file, place, "the name of a file or null", value)
        else:
            yield name


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _wrong(file: Path, place: str, expected: str, value: Any) -> BadFile:
    came = json.dumps(value)
    came = came if len(came) <= 40 else f"{came[:40]}…"
    return BadFile(f"{file}: {place + ': ' if place else ''}expected {expected}, came {came}")
