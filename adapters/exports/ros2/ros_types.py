"""The message types of ROS 2, from rosbags; or one line that says how to get it.

The types that the export writes have the same fields, and so the same hash, from Humble to Kilted; a test holds them
against each other.
"""

from __future__ import annotations

import importlib
from typing import Any

from station.errors import StationError


def _load() -> Any:
    try:
        return importlib.import_module("rosbags.typesys")
    except ImportError as error:
        raise StationError(
            f"ROS 2 bags need rosbags ({error}); install it with `pip install 'teleop-station[ros2]'`"
        ) from error


_typesys: Any = _load()  # its classes of messages are made when it is imported

_STORE: Any = _typesys.get_typestore(_typesys.Stores.ROS2_JAZZY)
_NANOSECONDS = 1_000_000_000


def make(type_name: str, *values: Any) -> Any:
    """Return a message; values are those of its fields, in order. Numbers of an array are a NumPy array."""
    return _STORE.types[type_name](*values)


def cdr(message: Any) -> bytes:
    """Return a message as little-endian CDR."""
    return bytes(_STORE.serialize_cdr(message, message.__msgtype__))


def definition(type_name: str) -> tuple[str, str]:
    """Return the definition of a type with those that it is made of, as ``ros2msg``, and its hash (REP-2016)."""
    text, _ = _STORE.generate_msgdef(type_name, ros_version=2)
    return text, _STORE.hash_rihs01(type_name)


def header(stamp_ns: int, frame: str = "") -> Any:
    """Return a header: an instant [ns since the epoch] and a frame."""
    seconds, nanos = divmod(stamp_ns, _NANOSECONDS)
    return make("std_msgs/msg/Header", make("builtin_interfaces/msg/Time", seconds, nanos), frame)
