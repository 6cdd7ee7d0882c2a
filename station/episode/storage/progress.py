"""How an episode is written, what is in its file, and how far it is safe: plain values, no file, no thread."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import msgspec

from station.atomic_file import refuse_special, write_atomic
from station.bus.clocks import OffsetOf, unknown
from station.bus.tap import Position
from station.episode.storage import layout
from station.episode.storage.anchor import Anchor
from station.episode.storage.drops import Dropped
from station.episode.storage.manifest import Stream


class WriterOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How an episode is written.

    Attributes:
        flush_s: Longest time between two flushes to the disk [s]: what a power cut loses.
        flush_bytes: Size of the values that makes a flush come sooner: a bound of the memory.
        queue_writes, queue_bytes: Bounds of the queue, see `station.episode.recorder.queue.WriteQueue`.
        offset_of: How the clocks of other machines are to be read, so that their times of writing are on ours.
    """

    flush_s: float = 0.5
    flush_bytes: int = 8 * 1024 * 1024
    queue_writes: int = 200_000
    queue_bytes: int = 128 * 1024 * 1024
    offset_of: OffsetOf = unknown


class Gap(NamedTuple):
    """Sequence numbers of one writer that are missing: log times before and after [ns], and how many."""

    before_ns: int
    after_ns: int
    lost: int


class Totals(msgspec.Struct, frozen=True, kw_only=True):
    """What is in the files.

    Attributes:
        messages: Messages, without the recorder's own bookkeeping.
        bytes: Size of the files so far.
        dropped: Writes that arrived and are not in them.
        first_ns, last_ns: Log times of the first and last message [ns]; 0 when there is none.
        streams: Counters per channel.
        gaps: Where sequence numbers are missing; the first ones, if there are very many.
        lag_p50_ms, lag_p99_ms: From arrival to the place in the file.
    """

    messages: int = 0
    bytes: int = 0
    dropped: int = 0
    first_ns: int = 0
    last_ns: int = 0
    streams: list[Stream] = []
    gaps: list[Gap] = []
    lag_p50_ms: float | None = None
    lag_p99_ms: float | None = None


class ResumePoint(msgspec.Struct, frozen=True, kw_only=True):
    """How far an unfinished episode is safely on disk; what a new recorder needs to take it up again.

    Attributes:
        episode_id: The episode.
        position: The tap's place after the last write that is in the file; None where the tap has none.
        size: Length of the file of signals at that moment; bytes behind it belong to no flush. 0 before it was made.
        cameras_size, clouds_size: The same of the files of pictures and of clouds.
        messages: Messages in all at that moment.
        anchor: Clock of the file's log times.
        wall_ns, mono_ns: When it was written, on both clocks [ns].
        dropped: Writes before that position that arrived and could not be kept.
        drops: The same per key and writer.
        start_id: Id of the request that began the episode.
    """

    episode_id: str
    position: Position | None
    size: int
    messages: int
    anchor: Anchor
    wall_ns: int
    mono_ns: int = 0
    cameras_size: int = 0
    clouds_size: int = 0
    dropped: int = 0
    drops: list[Dropped] = []
    start_id: str = ""

    def sizes(self) -> dict[layout.Names, int]:
        """Return the length of each file at that moment."""
        lengths = (self.size, self.cameras_size, self.clouds_size)
        return dict(zip(layout.ALL_NAMES, lengths, strict=True))


def save_resume_point(point: ResumePoint, folder: Path) -> None:
    """Write how far an episode is safe; survives the death of the process, not that of the machine.

    Raises:
        OSError: the disk refused it.
    """
    write_atomic(folder / layout.RESUME, msgspec.json.encode(point), sync=False)


def load_resume_point(folder: Path) -> ResumePoint | None:
    """Return how far an unfinished episode is safe; None where nothing readable says so (a finished one has none)."""
    try:
        refuse_special(folder / layout.RESUME)
        return msgspec.json.decode((folder / layout.RESUME).read_bytes(), type=ResumePoint)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
