"""Writes an episode in a thread behind a bounded queue, so that a slow disk never holds up the reader of the bus."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import msgspec

from station.episode import layout
from station.episode.anchor import Anchor
from station.episode.atomic import sync_folder
from station.episode.closing import summary_record
from station.episode.disk import why_not
from station.episode.lag import Lag
from station.episode.ledger import Ledger
from station.episode.manifest import Manifest, dump_manifest, save_manifest, snapshot
from station.episode.progress import Totals, WriterOptions
from station.episode.signals import SignalsFile
from station.errors import EpisodeError

if TYPE_CHECKING:
    from station.bus.tap import Position, Write

log = logging.getLogger(__name__)

_LINGER_S = 0.004  # taking writes in handfuls halves the CPU at 10 000 a second, and nobody waits for them
_HURRY_WRITES = 2000

WriterState = Literal["opening", "open", "finishing", "finished", "failed"]


Closing = Callable[[Totals], Manifest]
"""Given the counters of the file, returns the manifest that closes it; called in the writer's thread."""


class _Batch(msgspec.Struct, frozen=True):
    writes: Sequence[Write]
    size: int
    position: Position | None
    is_live: bool
    is_whole: bool


class EpisodeWriter:
    """Writes one episode into its folder. Every method returns at once, except `wait`.

    Args:
        folder: The episode's folder, already made.
        anchor: Clock of the file.
        manifest: What is known before the first write.
        options: How to write.
        start_id: Id of the request that began the episode, for whoever takes it up again.
        place: Where the tap stood before the first write, for the same.
        reopened: The file of an episode that is taken up again; None makes a new one.
        dropped: How many writes the episode lacks already.

    A disk that is full or gone never raises here: `state` becomes ``failed`` and `error` says why in one line, what
    comes later is counted as dropped, and the ``.active`` file keeps every flush that succeeded.

    Attributes:
        state: ``opening`` until the head of the file and the first batch are on the disk.
        error: Why it failed, "" otherwise.
        dropped: Writes that are not and will not be in the file.
    """

    def __init__(
        self, folder: Path, *, anchor: Anchor, manifest: Manifest, options: WriterOptions | None = None,
        start_id: str = "", place: Position | None = None, reopened: SignalsFile | None = None, dropped: int = 0,
    ) -> None:  # fmt: skip
        self.folder = folder
        self.anchor = anchor
        self.state: WriterState = "opening"
        self.error = ""
        self.dropped = dropped
        self.lag = Lag()
        self._options = options or WriterOptions()
        self._queue: deque[_Batch] = deque()
        self._wake = threading.Condition()
        self._queued_writes = self._queued_bytes = 0
        self._saved = snapshot(manifest)
        self._manifest: Manifest | None = self._saved
        self._episode_id = manifest.episode_id
        task, started = manifest.task.name, manifest.timing.started
        self._facts = {"episode_id": manifest.episode_id, "task": task, "started": started}
        self._closing: Closing | None = None
        self._signals = reopened
        self._ledger = Ledger(folder, manifest.episode_id, anchor, start_id)
        self._position = place
        self._is_whole = True  # the position is that of the last write; never flushed in between
        self._thread = threading.Thread(target=self._run, name=f"writer {manifest.episode_id}", daemon=True)
        self._thread.start()

    def put(
        self, writes: Sequence[Write], *, position: Position | None = None, is_live: bool = True, is_whole: bool = True
    ) -> int:
        """Queue writes in the order of their arrival; return how many were dropped because the queue is full.

        Args:
            writes: What the tap returned; not to be changed afterwards.
            position: The tap's position after the last of them; saved once they are on the disk.
            is_live: False for the pre-roll, whose age says nothing about the writer.
            is_whole: False when more must follow before the position is known; nothing is flushed until then, since
                a recorder that is killed and resumes at a position must find exactly what came before it.
        """
        size = sum(len(write[1]) if write[1] is not None else 0 for write in writes)
        with self._wake:
            is_full = (
                self._queued_writes + len(writes) > self._options.queue_writes
                or self._queued_bytes + size > self._options.queue_bytes
            )
            if is_full or self.state in ("failed", "finished") or self._closing is not None:
                self.dropped += len(writes)
                return len(writes)
            self._queued_writes += len(writes)
            self._queued_bytes += size
            was_idle = not self._queue
            self._queue.append(_Batch(writes, size, position, is_live, is_whole))
            if was_idle:
                self._wake.notify()
        return 0

    def save_manifest(self, manifest: Manifest) -> None:
        """Have the manifest written to disk as it is now; a newer one replaces one that still waits."""
        copied = snapshot(manifest)
        with self._wake:
            self._manifest = copied
            self._wake.notify()

    def finish(self, closing: Closing) -> None:
        """Have everything queued written, the episode closed, and the file renamed to its final name."""
        with self._wake:
            if self._closing is None:
                self._closing = closing
                self._wake.notify()

    def wait(self, timeout_s: float) -> bool:
        """Wait until the episode is finished or has failed; return whether it is."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    @property
    def messages(self) -> int:
        """Messages in the file so far."""
        return self._signals.messages if self._signals else 0

    @property
    def size(self) -> int:
        """Bytes of the file on the disk so far."""
        return self._signals.size if self._signals else 0

    @property
    def queued(self) -> int:
        """Writes that wait for the disk."""
        return self._queued_writes

    @property
    def is_congested(self) -> bool:
        """Whether the queue is half full."""
        return (
            2 * self._queued_writes > self._options.queue_writes or 2 * self._queued_bytes > self._options.queue_bytes
        )

    def _run(self) -> None:
        try:
            self._open()
            self._work()
            self._close()
        except (OSError, EpisodeError) as error:
            self._fail(why_not(error, self.folder))
        finally:
            if self.state not in ("finished", "failed"):  # our own fault; Python prints where
                self._fail("internal error, see the log")
            if self._signals is not None:
                self._signals.close()

    def _open(self) -> None:
        if self._signals is None:
            self._ledger.note(
                self._position, None, self.dropped
            )  # before all else: what is there without it has nobody to go on with it
        manifest = self._next_manifest()
        data = save_manifest(manifest, self.folder) if manifest else b""
        if self._signals is None:
            self._signals = SignalsFile.create(self.folder / layout.ACTIVE, self.anchor, self._facts, data)
            sync_folder(self.folder)
        else:
            self.state = "open"
        self._ledger.note(self._position, self._signals, self.dropped)

    def _work(self) -> None:
        """Write batches until asked to finish; flush by size, by time, and once after the first batch."""
        signals = self._opened()
        deadline = time.monotonic()
        while True:
            batches, is_closing = self._next_batches(deadline if signals.pending_bytes else None)
            if (manifest := self._next_manifest()) is not None:  # before what follows it: a hole, then the writes
                save_manifest(manifest, self.folder)
            for batch in batches:
                self._write(signals, batch)
                if signals.pending_bytes >= self._options.flush_bytes and self._is_whole:
                    deadline = self._flush(signals)
            if signals.pending_bytes and time.monotonic() >= deadline and self._is_whole:
                deadline = self._flush(signals)
            if self.state == "opening" and batches and self._is_whole:
                self.state = "open"
            if is_closing:
                return

    def _write(self, signals: SignalsFile, batch: _Batch) -> None:
        for write in batch.writes:
            signals.add(write)
        self._is_whole = batch.is_whole
        if batch.is_whole:
            self._position = batch.position
        with self._wake:
            self._queued_writes -= len(batch.writes)
            self._queued_bytes -= batch.size
        if batch.is_live and batch.writes:
            self.lag.note(time.monotonic_ns() - batch.writes[0][3])

    def _flush(self, signals: SignalsFile) -> float:
        """Bring everything to the disk and say so in the ledger; return when the next flush is due."""
        signals.sync()
        self._ledger.note(self._position, signals, self.dropped)
        return time.monotonic() + self._options.flush_s

    def _close(self) -> None:
        signals = self._opened()
        self.state = "finishing"
        signals.sync()
        totals = self.totals()
        closing = self._closing
        if closing is None:
            raise RuntimeError("closing an episode that nobody asked to finish")
        manifest = closing(totals)
        signals.finish(dump_manifest(manifest), summary_record(totals))
        (self.folder / layout.ACTIVE).rename(self.folder / layout.SIGNALS)
        sync_folder(self.folder)
        manifest.recorder.bytes = signals.size
        save_manifest(manifest, self.folder)
        self._ledger.remove()
        self.state = "finished"

    def totals(self) -> Totals:
        """Return the counters of the file; exact once the state is ``finished`` or ``failed``."""
        if self._signals is None:
            return Totals(dropped=self.dropped)
        return self._signals.totals(self.dropped, self.lag)

    def _next_batches(self, deadline: float | None) -> tuple[list[_Batch], bool]:
        """Wait for work, at most until the deadline; return the batches and whether they are the last."""
        with self._wake:
            if not (self._queue or self._closing is not None or self._manifest is not None):
                self._wake.wait(None if deadline is None else max(0.0, deadline - time.monotonic()))
        if self._queued_writes < _HURRY_WRITES and self._closing is None:
            time.sleep(_LINGER_S)
        with self._wake:
            batches = list(self._queue)
            self._queue.clear()
            return batches, self._closing is not None

    def _next_manifest(self) -> Manifest | None:
        with self._wake:
            manifest, self._manifest = self._manifest, None
            self._saved = manifest or self._saved
            return manifest

    def _opened(self) -> SignalsFile:
        if self._signals is None:
            raise RuntimeError("the file is not open")
        return self._signals

    def _fail(self, reason: str) -> None:
        with self._wake:
            self.error = f"episode {self._episode_id}: cannot be written any more: {reason}"
            self.state = "failed"
            self.dropped += self._queued_writes + (self._signals.unsynced_messages if self._signals else 0)
            self._queue.clear()
            self._queued_writes = self._queued_bytes = 0
        log.error("%s", self.error)
        self._saved.state = "failed"
        self._saved.recorder.ended_by = self.error
        try:
            save_manifest(self._saved, self.folder)
        except EpisodeError as error:
            log.error("%s", error)
            with contextlib.suppress(OSError):  # of an episode that could not even begin, leave nothing; else keep all
                self._ledger.remove()
                self.folder.rmdir()
