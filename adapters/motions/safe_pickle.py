"""A pickle read as data: numbers, text, lists, dicts and numpy arrays of numbers; anything else is refused by name.

A pickle is a program. What it may call here is a list of names that numpy's own pickles use, and behind each name
stands not numpy's function but a stand-in of ours that only takes the arguments such pickles give. So nothing of
numpy's reconstruction (which trusts its input) is within reach of the file.
"""

from __future__ import annotations

import io
import math
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from adapters.motions import pickle_survey
from station.errors import BadFile

_DTYPE = re.compile(r"[<>|=]?[biuf]\d{1,2}")
_LARGEST_SIDE = 1 << 40  # of an array; without a bound the product of the sides may be hours of arithmetic
_MOST_SIDES = 32
_DEEPEST = 8  # lists within lists; a motion's have two levels
_PLAIN_DTYPE_STATE = (None, None, None, -1, -1, 0)  # no sub-array, no names, no fields, usual size, alignment, flags
_TORN = (
    pickle.UnpicklingError, EOFError, ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError,
    MemoryError, RecursionError,
)  # fmt: skip


def load_plain(path: Path, data: bytes) -> Any:
    """Return what a pickle holds.

    Args:
        path: Where the bytes came from, for messages.
        data: The pickle, of any protocol up to 5.

    Raises:
        BadFile: torn, or it asks for anything beyond plain data and arrays of numbers.
    """
    try:
        pickle_survey.check(data)
        value = _Reader(path, data).load()
        _check_size(value, len(data))
        return _plain(value)
    except BadFile:
        raise
    except (_Refused, pickle_survey.Unfit) as error:
        raise BadFile(f"{path}: {error}; refused") from None
    except _TORN as error:
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise BadFile(f"{path}: not a readable pickle, or cut short ({reason}); fetch or export it again") from error


class _Refused(Exception):
    """The pickle asks for something that plain data does not need."""


class _Reader(pickle.Unpickler):
    def __init__(self, path: Path, data: bytes) -> None:
        super().__init__(io.BytesIO(data))
        self._path = path

    def find_class(self, module: str, name: str) -> Any:
        call = _ALLOWED.get((module, name))
        if call is None:
            raise BadFile(
                f"{self._path}: asks Python to load {module}.{name}, which no motion file needs; "
                "refused, and nothing of it was run: do not trust this file"
            )
        return _Global(call)


class _Global:
    """What a name in the pickle stands for; it can be called and passed on, and nothing else."""

    __slots__ = ("_call",)

    def __init__(self, call: Callable[..., Any]) -> None:
        self._call = call

    def __call__(self, *arguments: Any) -> Any:
        return self._call(*arguments)

    def __setstate__(self, state: Any) -> None:
        raise _Refused("tries to change a function")


class _Dtype:
    """Stands for a numpy dtype: plain booleans, integers and floats only."""

    __slots__ = ("dtype",)

    def __init__(self, code: Any, *_: Any) -> None:
        text = code.decode("ascii", "replace") if isinstance(code, bytes) else code
        if not isinstance(text, str) or not _DTYPE.fullmatch(text):
            raise _Refused(f"holds an array of dtype {_named(text)}, expected numbers")
        self.dtype: np.dtype[Any] = np.dtype(text)

    def __setstate__(self, state: Any) -> None:
        _version, order, *rest = state
        if tuple(rest[:6]) != _PLAIN_DTYPE_STATE:
            raise _Refused("holds an array of a structured dtype, expected numbers")
        self.dtype = self.dtype.newbyteorder("|" if order == "|" else "<" if order == "<" else ">")


class _Array:
    """Stands for a numpy array; `value` is the array once its state has been given."""

    __slots__ = ("value",)

    def __init__(self, *_: Any) -> None:
        self.value: Any = None

    def __setstate__(self, state: Any) -> None:
        _version, shape, dtype, is_fortran, data = state
        self.value = _from_bytes(data, dtype, shape, "F" if is_fortran else "C")


def _from_bytes(data: Any, dtype: Any, shape: Any, order: Any) -> Any:
    if isinstance(data, str):  # protocol 0 and 1 keep bytes as text
        data = data.encode("latin-1")
    if not isinstance(dtype, _Dtype) or not isinstance(data, (bytes, bytearray)):
        raise _Refused("holds an array that is not made of plain numbers")
    if not isinstance(shape, tuple) or len(shape) > _MOST_SIDES or order not in ("C", "F"):
        raise _Refused(f"holds an array of shape {_named(shape)}")
    sizes = shape
    if not all(isinstance(size, int) and 0 <= size < _LARGEST_SIDE for size in sizes):
        raise _Refused("holds an array whose shape is not made of sizes")
    if math.prod(sizes) * dtype.dtype.itemsize != len(data):
        raise ValueError(f"array of shape {sizes} with {len(data)} bytes")
    return np.frombuffer(bytes(data), dtype=dtype.dtype).reshape(sizes, order=order)


def _frombuffer(data: Any, dtype: Any, shape: Any, order: Any) -> _Array:
    array = _Array()
    array.value = _from_bytes(data, dtype, shape, order)
    return array


def _scalar(dtype: Any, data: Any) -> Any:
    return _from_bytes(data, dtype, (1,), "C")[0].item()


def _encode(text: Any, encoding: Any = "latin1") -> bytes:
    if not isinstance(text, str) or encoding not in ("latin1", "latin-1"):
        raise _Refused(f"asks for the codec {_named(encoding)}")
    return text.encode("latin-1")


def _not_called(*_: Any) -> Any:
    raise _Refused("calls numpy.ndarray")


_ALLOWED: dict[tuple[str, str], Callable[..., Any]] = {
    ("numpy", "ndarray"): _not_called,  # only handed to _reconstruct
    ("numpy", "dtype"): _Dtype,
    ("_codecs", "encode"): _encode,
}
for _core in ("numpy.core", "numpy._core"):  # before and since numpy 2
    _ALLOWED[f"{_core}.multiarray", "_reconstruct"] = _Array
    _ALLOWED[f"{_core}.multiarray", "scalar"] = _scalar
    _ALLOWED[f"{_core}.numeric", "_frombuffer"] = _frombuffer


def _named(value: Any) -> str:
    """Return a short text by itself and of anything else only the type: what it shows may be endless."""
    return repr(value[:20]) if isinstance(value, str) else type(value).__name__


def _check_size(value: Any, size: int) -> None:
    """Refuse lists that hold each other: a page of them stands for more than there is memory.

    Written out, each item of a list takes at least one byte of a file.
    """
    level, count = [value], 0
    for _ in range(_DEEPEST):
        inner = [item.values() if isinstance(item, dict) else item for item in level if isinstance(item, _HOLDERS)]
        count += sum(len(items) for items in inner)
        if count > size:
            raise _Refused("holds more items than it has bytes")
        level = [item for items in inner for item in items]
        if not level:
            return
    raise _Refused(f"holds lists more than {_DEEPEST} deep")


_HOLDERS = (dict, list, tuple)


def _plain(value: Any) -> Any:
    """Return the content with arrays in place of their stand-ins; only the top level of a motion holds any."""
    if isinstance(value, dict):
        return {key: _plain_item(item) for key, item in value.items()}
    return _plain_item(value)


def _plain_item(value: Any) -> Any:
    if isinstance(value, _Array):
        if value.value is None:
            raise _Refused("holds an array without content")
        return value.value
    return value
