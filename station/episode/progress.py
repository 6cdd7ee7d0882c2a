"""How an episode is written, what is in its file, and how far it is safe: plain values, no file, no thread."""

from __future__ import annotations

from pathlib import Path

import msgspec

from station.bus.tap import Position
from station.episode import layout
from station.episode.anchor import Anchor
from station.episode.manifest import Stream


class WriterOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How an episode is written.

    Attributes:
        flush_s: Longest time between two flushes to the disk [s]: what a killed recorder loses.
        flush_bytes: Size of the values that makes a flush come sooner.
        queue_writes, queue_bytes: Bounds of the queue; beyond them writes are dropped and counted.
    """

    flush_s: float = 0.5
    flush_bytes: int = 256 * 1024
    queue_writes: int = 200_000
    queue_bytes: int = 128 * 1024 * 1024


class Totals(msgspec.Struct, frozen=True, kw_only=True):
    """What is in the file.

    Attributes:
        messages: Messages, without the recorder's own bookkeeping.
        bytes: Size of the file so far.
        dropped: Writes that arrived and are not in the file.
        first_ns, last_ns: Log times of the first and last message [ns]; 0 when there is none.
        streams: Counters per channel.
        lag_p50_ms, lag_p99_ms: From arrival to the place in the file.
    """

    messages: int
    bytes: int
    dropped: int
    first_ns: int
    last_ns: int
    streams: list[Stream]
    lag_p50_ms: float | None
    lag_p99_ms: float | None


class ResumePoint(msgspec.Struct, frozen=True, kw_only=True):
    """How far an unfinished episode is safely on disk; what a new recorder needs to take it up again.

    Attributes:
        episode_id: The episode.
        position: The tap's place after the last write that is in the file; None where the tap has none.
        size: Length of the file at that moment; bytes behind it belong to no flush.
        messages: Messages in the file at that moment.
        anchor: Clock of the file's log times.
        wall_ns: When it was written.
    """

    episode_id: str
    position: Position | None
    size: int
    messages: int
    anchor: Anchor
    wall_ns: int


def load_resume_point(folder: Path) -> ResumePoint | None:
    """Return how far an unfinished episode is safe; None where nothing readable says so (a finished one has none)."""
    try:
        return msgspec.json.decode((folder / layout.RESUME).read_bytes(), type=ResumePoint)
    except (OSError, msgspec.DecodeError):
        return None
