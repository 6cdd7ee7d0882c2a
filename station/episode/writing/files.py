"""The MCAP files of an episode while they are written: signals, and pictures and clouds from the first one on."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from station.atomic_file import sync_folder
from station.bus.contracts import Contracts
from station.episode.storage import layout
from station.episode.storage.anchor import Anchor, is_storable
from station.episode.storage.bulk import names_of
from station.episode.storage.drops import Drops, drops_record, streams_of
from station.episode.storage.progress import ResumePoint, Totals
from station.episode.storage.records import metadata_at_head
from station.episode.writing.checkpoint import Checkpoint, load_checkpoint
from station.episode.writing.file import EpisodeFile, FarTimes

if TYPE_CHECKING:
    from station.bus.tap.base import Write


_DROPS_EVERY_S = 5.0  # a power cut may take so much of the counts of dropped writes; a kill takes none
_TIE_NS = 1000  # a step back of the log time by no more than this came of keeping the order

_WINDOW = 1024
_PLACES = {names: place for place, names in enumerate(layout.ALL_NAMES)}


class EpisodeFiles:
    """Takes the writes of an episode and puts each into its file.

    Who reads them merges the files by log time, at equal times in the order of `layout.ALL_NAMES`. That is the order of
    arrival, because a signal behind a picture that arrived in the same instant is logged a nanosecond later.

    Args:
        folder: Where the files of pictures and clouds are made.
        anchor: Clock of the files.
        facts: What stands at the head of each: episode_id, task, started.
        signals: The file of signals.
        bulk: The files of pictures and clouds, where there are any.

    Attributes:
        signals: As above.
        drops: Writes that belong before the end of the files and are not in them, refused ones included; the file of
            signals tells of all of them.
    """

    def __init__(
        self, folder: Path, anchor: Anchor, facts: Mapping[str, str], signals: EpisodeFile, *bulk: EpisodeFile
    ) -> None:
        self.signals = signals
        self._bulk = {file.names: file for file in bulk}
        self.drops = signals.drops
        self._folder = folder
        self._anchor = anchor
        self._facts = facts
        self._last_ns = max(file.last_log_ns for file in self)
        self._last_place = 0  # of the file of the last write, in the order in which they are read
        self._noted_drops, self._drops_due = 0, 0.0

    @property
    def contracts(self) -> Contracts:
        """What is known of keys when their channels are made."""
        return self.signals.contracts

    @contracts.setter
    def contracts(self, known: Contracts) -> None:
        for file in self:
            file.contracts = known

    @property
    def far(self) -> FarTimes:
        """When other machines wrote."""
        return self.signals.far

    @far.setter
    def far(self, known: FarTimes) -> None:
        for file in self:
            file.far = known

    @classmethod
    def create(cls, folder: Path, anchor: Anchor, facts: Mapping[str, str], manifest: bytes) -> EpisodeFiles:
        """Create the file of signals.

        Raises:
            OSError: the disk refused it, or the file exists.
        """
        signals = EpisodeFile.create(folder / layout.ACTIVE, anchor, facts, manifest=manifest)
        sync_folder(folder)
        return cls(folder, anchor, facts, signals)

    @classmethod
    def reopen(cls, folder: Path, facts: Mapping[str, str], point: ResumePoint, *, is_exact: bool) -> EpisodeFiles:
        """Go on with files that were never finished.

        Args:
            folder: Folder of the episode.
            facts: As for `create`.
            point: How far they are safe; the file of signals was there.
            is_exact: Whether to go on exactly behind what is safe, else behind the last whole chunk of each.

        Raises:
            OSError: the disk refused it.
            EpisodeError: one of them is damaged.
        """
        drops = Drops(point.drops)
        opened: list[EpisodeFile] = []
        try:
            for names, size in point.sizes().items():
                path = folder / names.active
                if not (size or (path.exists() and not is_exact and metadata_at_head(path, layout.ANCHOR_RECORD))):
                    path.unlink(missing_ok=True)  # it was not safe yet, not even its head; what was in it comes again
                    continue
                length = path.stat().st_size if path.exists() else 0
                known = load_checkpoint(folder, names.final, min(length, size))
                kept = size if is_exact else None
                opened.append(
                    EpisodeFile.reopen(path, point.anchor, size=kept, checkpoint=known, names=names, drops=drops)
                )
            return cls(folder, point.anchor, facts, *opened)
        except BaseException:
            for file in opened:
                file.close()
            raise

    def __iter__(self) -> Iterator[EpisodeFile]:
        """Iterate over the files that there are; signals last, so that what is said of them holds for all."""
        yield from (self._bulk[names] for names in reversed(layout.BULK_NAMES) if names in self._bulk)
        yield self.signals

    @property
    def messages(self) -> int:
        """Messages, flushed or not."""
        return sum(file.messages for file in self)

    @property
    def size(self) -> int:
        """Bytes that the system has."""
        return sum(file.size for file in self)

    def size_of(self, names: layout.Names) -> int:
        """Return the bytes of one file that the system has; 0 where it was not made."""
        return sum(file.size for file in self if file.names is names)

    @property
    def refused(self) -> int:
        """Writes that could not be kept, because there were too many channels."""
        return sum(file.refused for file in self)

    @property
    def pending_bytes(self) -> int:
        """Size of the values since the last flush."""
        return sum(file.pending_bytes for file in self)

    @property
    def unsynced_messages(self) -> int:
        """Messages that are not on the disk yet."""
        return sum(file.unsynced_messages for file in self)

    def totals(self, dropped: int = 0, lag: Lag | None = None) -> Totals:
        """Return the counters; `dropped` writes never came here, and `lag` is the writer's."""
        channels = [channel for file in reversed([*self]) for channel in file.channels]
        counted = [channel for channel in channels if channel.count]
        return Totals(
            messages=self.messages,
            bytes=self.size,
            dropped=dropped + self.refused,
            first_ns=min((channel.first_ns for channel in counted), default=0),
            last_ns=max((channel.last_ns for channel in counted), default=0),
            streams=streams_of(channels, self.drops, self._anchor.wall_ns, self.contracts.get),
            gaps=[gap for file in self for gap in file.gaps],
            lag_p50_ms=lag.percentile_ms(50) if lag else None,
            lag_p99_ms=lag.percentile_ms(99) if lag else None,
        )

    def checkpoints(self) -> dict[str, Checkpoint]:
        """Return what is known of each file as far as it is flushed, by its name; nothing of one that is too much."""
        found = {file.names.final: file.checkpoint() for file in self}
        return {name: checkpoint for name, checkpoint in found.items() if checkpoint is not None}

    def add(self, writes: Iterable[Write]) -> None:
        """Put writes into the open chunks of their files.

        Raises:
            OSError: the disk refused a file of pictures or clouds, which is made for the first one.
        """
        at = self._anchor.at
        for write in writes:
            log_ns, last_ns = at(write[3]), self._last_ns
            if not is_storable(log_ns):
                log_ns = last_ns
            names = layout.SIGNALS_NAMES if write[1] is None else names_of(write[0])
            file = self.signals if names is layout.SIGNALS_NAMES else self._bulk.get(names) or self._make(names)
            place = _PLACES[names]
            if self._bulk and 0 <= last_ns - log_ns < _TIE_NS:
                log_ns = last_ns + (place < self._last_place)
            self._last_ns, self._last_place = log_ns, place
            file.add(write, log_ns)

    def sync(self) -> None:
        """Close the chunks and wait until they are on the disk; a disk that refuses pictures may still take signals.

        Raises:
            OSError: the disk is full or gone.
        """
        try:
            for file in self._bulk.values():
                if file.pending_bytes:
                    file.sync()
        finally:
            if self.drops.total > self._noted_drops and time.monotonic() >= self._drops_due:
                self._write_drops()
            self.signals.sync()

    def finish(self, manifest: bytes, summary: Mapping[str, str]) -> None:
        """Close the last chunks, add summary and closed manifest, write the indexes, and give the files their names.

        Whoever finds the file of signals finished finds all others finished too; and whoever finds it by its
        final name, likewise.

        Raises:
            OSError: the disk is full or gone.
        """
        # Each file is waited for twice: its messages, then its end. So after a power cut a file that has an end is
        # whole, and one without is cut at its last whole chunk. The names follow once both ends are safe.
        if self.drops.total > self._noted_drops:
            self._write_drops()
        self.sync()
        for file in self._bulk.values():
            file.finish({"messages": str(file.messages)})
        self.signals.finish(summary, manifest)

    def name(self) -> None:
        """Give the finished files their final names, that of the signals last."""
        for file in self:
            file.path.rename(self._folder / file.names.final)
        sync_folder(self._folder)

    def close(self) -> None:
        """Release the files; that of the signals, by which others see that they are being written, last."""
        for file in self:
            file.close()

    def _make(self, names: layout.Names) -> EpisodeFile:
        path = self._folder / names.active
        made = EpisodeFile.create(path, self._anchor, self._facts, names=names, drops=self.drops)
        made.contracts, made.far = self.contracts, self.far
        self._bulk[names] = made
        sync_folder(self._folder)
        return made

    def _write_drops(self) -> None:
        self.signals.write_metadata(layout.DROPPED_RECORD, drops_record(self.drops))
        self._noted_drops, self._drops_due = self.drops.total, time.monotonic() + _DROPS_EVERY_S


class Lag:
    """Keeps the newest durations; written by one thread, read by another."""

    def __init__(self) -> None:
        self._newest_ns: deque[int] = deque(maxlen=_WINDOW)
        self.longest_ns = 0

    def add(self, duration_ns: int) -> None:
        """Add one duration [ns]."""
        self._newest_ns.append(duration_ns)
        self.longest_ns = max(self.longest_ns, duration_ns)

    def percentile_ms(self, percent: float) -> float | None:
        """Return a percentile of the newest durations [ms], or None before the first."""
        ordered = sorted(self._newest_ns.copy())
        if not ordered:
            return None
        return round(ordered[min(len(ordered) - 1, int(len(ordered) * percent / 100))] * 1e-6, 3)
