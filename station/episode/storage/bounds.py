"""Plain data cut to a size: what others write on the bus must not make a manifest that no reader takes.

The size of a value is an estimate of its bytes as YAML. What is too large is shared out: whatever is small stays whole,
and the large values, texts and lists are cut to what is left. A text that was cut says how long it was.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

_VALUE = 40  # as many bytes for each value: a reader takes 8,000,000 bytes and 200,000 values (`station.safe_yaml`)
_STUB = 80  # of a text or a list of which nothing is left but a word that it was there
_ESCAPED = 10  # bytes of the longest escape of a character
_ODD = re.compile("[^ -~]")  # a character that is escaped, or at least longer than a byte
_MARK = re.compile(r"\.\.\. \((\d{1,20}) characters\)\Z")
_DEEPEST = 40  # a reader takes 50 levels
_LONGEST_NUMBER = 64  # bits; msgspec, JavaScript and C++ read no longer ones


class Cut(NamedTuple):
    """A value that was cut, and how many texts, numbers and members were cut or left out."""

    value: Any
    cuts: int


def size_of(value: Any) -> int:
    """Return the estimated size of a value [bytes of YAML]."""
    if isinstance(value, str):
        return _VALUE + _printed(value)
    if isinstance(value, dict):
        return _VALUE + sum(size_of(key) + size_of(inner) for key, inner in value.items())
    if isinstance(value, (list, tuple)):
        return _VALUE + sum(map(size_of, value))
    if isinstance(value, msgspec.Struct):
        return size_of(_fields(value))
    return _VALUE


def cut(value: Any, most: int) -> Cut:
    """Cut a value to a size [bytes of YAML]; structs become dicts, and keep all of their fields.

    An integer that 64 bits cannot hold becomes a text. What cannot be made so small is made as small as it can. Plain
    data that fits is returned as it is.
    """
    return Cut(value, 0) if _plain_size(value) <= most else _cut(value, most, 0)


def _cut(value: Any, most: int, depth: int) -> Cut:
    if isinstance(value, str):
        return _cut_text(value, most)
    if isinstance(value, int) and value.bit_length() > _LONGEST_NUMBER:
        return Cut(_cut_text(str(value), _STUB).value, 1)
    if isinstance(value, msgspec.Struct):
        found = cut_each(_fields(value), most, depth=depth, may_drop=False)
        return _together(found, 0)
    if isinstance(value, dict):
        found = cut_each(value, most, depth=depth)
        return _together(found, len(value) - len(found))
    if isinstance(value, (list, tuple)):
        found = cut_each(dict(enumerate(value)), most, depth=depth)
        together = _together(found, len(value) - len(found))
        return Cut([*together.value.values()], together.cuts)
    return Cut(value, 0)


def cut_each(members: Mapping[Any, Any], most: int, *, depth: int = 0, may_drop: bool = True) -> dict[Any, Cut]:
    """Share a size [bytes of YAML] out to the members of a mapping; what does not fit even when cut is left out."""
    if depth > _DEEPEST and may_drop:
        return {}
    left = most - _VALUE
    least: dict[Any, int] = {}
    for key, value in members.items():
        size = _key_size(key) + _least(value)
        if size <= left or not may_drop:
            least[key] = size
            left -= size
    plain = {key: _key_size(key) + _plain_size(members[key], depth + 1) for key in least}
    sizes = [_key_size(key) + size_of(members[key]) if size == math.inf else int(size) for key, size in plain.items()]
    level = _level(sizes, [*least.values()], most - _VALUE)
    return {
        key: Cut(members[key], 0)
        if plain[key] <= max(floor, level)
        else _cut(members[key], max(floor, level) - _key_size(key), depth + 1)
        for key, floor in least.items()
    }


def _plain_size(value: Any, depth: int = 0) -> float:
    """Return what `size_of` does; infinity for what `cut` changes though it fits."""
    if isinstance(value, dict):
        if depth > _DEEPEST:
            return math.inf
        return _VALUE + sum(size_of(key) + _plain_size(inner, depth + 1) for key, inner in value.items())
    if isinstance(value, list):
        return math.inf if depth > _DEEPEST else _VALUE + sum(_plain_size(inner, depth + 1) for inner in value)
    if isinstance(value, int):
        return math.inf if value.bit_length() > _LONGEST_NUMBER else _VALUE
    return math.inf if isinstance(value, (tuple, msgspec.Struct)) else size_of(value)


def _together(found: dict[Any, Cut], left_out: int) -> Cut:
    values = {key: inner.value for key, inner in found.items()}
    return Cut(values, left_out + sum(inner.cuts for inner in found.values()))


def _fields(value: msgspec.Struct) -> dict[str, Any]:
    return {name: getattr(value, name) for name in value.__struct_fields__}


def _cut_text(text: str, most: int) -> Cut:
    if size_of(text) <= max(most, _STUB):
        return Cut(text, 0)
    cut_before = _MARK.search(text)
    length = cut_before.group(1) if cut_before else len(text)
    room = max(0, most - _STUB) // (_ESCAPED if _ODD.search(text) else 1)
    return Cut(f"{text[:room]}... ({length} characters)", 1)


def _level(sizes: Sequence[int], least: Sequence[int], most: int) -> int:
    """Return up to which size members stay whole so that all together have a size."""
    if sum(sizes) <= most:
        return max(sizes, default=0)
    import numpy as np  # for what is too large: a list of episodes is there sooner without

    wanted, floors = np.array(sizes), np.array(least)
    low, high = 0, max(0, most)
    while low < high:
        level = (low + high + 1) // 2
        fits = np.maximum(floors, np.minimum(wanted, level)).sum() <= most
        low, high = (level, high) if fits else (low, level - 1)
    return low


def _least(value: Any) -> int:
    """Return the size below which a value cannot be cut."""
    if isinstance(value, str):
        return min(size_of(value), _STUB)
    if isinstance(value, msgspec.Struct):
        return _VALUE + sum(_key_size(name) + _least(inner) for name, inner in _fields(value).items())
    return _VALUE


def _key_size(key: Any) -> int:
    return size_of(key) if isinstance(key, str) else 0


def _printed(text: str) -> int:
    return len(text) + (_ESCAPED - 1) * (0 if text.isascii() and text.isprintable() else _ODD.subn("", text)[1])
