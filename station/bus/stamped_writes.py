"""Writes as they go over the wire: keys and their stamps as one atomic command, numbered by key."""

from __future__ import annotations

from collections.abc import Mapping

from station.bus import keys, stamp
from station.clock import Clock


class StampedWrites:
    """The writes of one source; not safe to share between threads.

    Args:
        source: Stands in every stamp.
        clock: Its instants stand in every stamp.
    """

    def __init__(self, source: str, clock: Clock) -> None:
        self._source, self._clock = source, clock
        self._sequences: dict[str, int] = {}
        self._frames: dict[str, tuple[bytes, bytes]] = {}  # name of a key and of its stamp, as they are sent

    def encode(self, values: Mapping[str, bytes], capture_ns: int | None) -> bytes:
        """Return the request that writes values by key now; it spends a number of each key.

        Args:
            values: Bytes by key.
            capture_ns: A device's own time of capture [ns], for the stamps.
        """
        mono_ns, wall_ns = self._clock.monotonic_ns(), self._clock.wall_ns()
        parts = [b"*%d\r\n$4\r\nMSET\r\n" % (1 + 4 * len(values))]
        for key, value in values.items():
            seq = self._sequences[key] = self._sequences.get(key, 0) + 1
            mark = stamp.Stamp(seq, mono_ns, wall_ns, self._source, capture_ns).encode()
            frame, stamp_frame = self._frames.get(key) or self._frame(key)
            parts += (
                frame,
                b"$%d\r\n" % len(value),
                value,
                b"\r\n",
                stamp_frame,
                b"$%d\r\n" % len(mark),
                mark,
                b"\r\n",
            )
        return b"".join(parts)

    def _frame(self, key: str) -> tuple[bytes, bytes]:
        frames = (_bulk(key), _bulk(keys.stamp(key)))
        self._frames[key] = frames
        return frames


def _bulk(text: str) -> bytes:
    data = text.encode("utf-8", "surrogateescape")
    return b"$%d\r\n%s\r\n" % (len(data), data)
