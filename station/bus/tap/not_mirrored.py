"""What a tap says of a write that it knows of and cannot show: in the stream of writes, at the place of that write.

So it is in the recording like any write, and is neither lost nor said twice when the tap or its recorder is cut off.
"""

from __future__ import annotations

from typing import Annotated

import msgspec

from station.bus import codec, keys
from station.bus.tap.base import Write, key_name

_LONGEST_COMMAND = 40
_LONGEST_KEY = 200

Text = Annotated[str, msgspec.Meta(max_length=6 * _LONGEST_KEY)]


class NotMirrored(msgspec.Struct, frozen=True):
    """A command that changed a key to a value that the tap does not know; `key` is "" where it is not known either.

    Attributes:
        command: Its name, upper case.
        key: The key.
        count: How many such changes this stands for.
    """

    command: Text
    key: Text
    count: Annotated[int, msgspec.Meta(ge=1, le=1 << 32)] = 1

    def write(self, mono_ns: int) -> Write:
        """Return the write that says so, as of an arrival at the tap [ns, monotonic]."""
        return Write(keys.NOT_MIRRORED, msgspec.json.encode(self), None, mono_ns)


def not_mirrored(command: bytes, key: bytes) -> NotMirrored:
    """Return what is said of a command of the stream."""
    return NotMirrored(key_name(command[:_LONGEST_COMMAND]).upper(), key_name(key[:_LONGEST_KEY]))


def decode(value: bytes) -> NotMirrored | None:
    """Return what a write of `keys.NOT_MIRRORED` says; None for a stranger's, which says something else."""
    try:
        return codec.parse_struct(value, NotMirrored)
    except codec.BadValue:
        return None
