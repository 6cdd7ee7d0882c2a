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
from station.episode.atomic import sync_folder, write_atomic
from station.episode.lag import Lag
from station.episode.manifest import Manifest, dump_manifest, save_manifest, snapshot
from station.episode.progress import ResumePoint, Totals, WriterOptions
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


class EpisodeWriter:
    """Writes one episode into its folder. Every method returns at once, except `wait`.

    A disk that is full or gone never raises here: `state` becomes ``failed`` and `error` says why in one line, what
    comes later is counted as dropped, and the ``.active`` file keeps every flush that succeeded.

    Attributes:
        state: ``opening`` until the head of the file and the first batch are on the disk.
        error: Why it failed, "" otherwise.
        dropped: Writes that are not and will not be in the file.
    """

    def __init__(
        self, folder: Path, *, anchor: Anchor, manifest: Manifest, options: WriterOptions | None = None
    ) -> None:
        self.folder = folder
        self.anchor = anchor
        self.state: WriterState = "opening"
        self.error = ""
        self.dropped = 0
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
        self._signals: SignalsFile | None = None
        self._position: Position | None = None
        self._thread = threading.Thread(target=self._run, name=f"writer {manifest.episode_id}", daemon=True)
        self._thread.start()

    def put(self, writes: Sequence[Write], *, position: Position | None = None, is_live: bool = True) -> int:
        """Queue writes in the order of their arrival; return how many were dropped because the queue is full.

        Args:
            writes: What the tap returned; not to be changed afterwards.
            position: The tap's position after the last of them; saved once they are on the disk.
            is_live: False for the pre-roll, whose age says nothing about the writer.
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
            self._queue.append(_Batch(writes, size, position, is_live))
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

    def _run(self) -> None:
        try:
            self._open()
            self._work()
            self._close()
        except (OSError, EpisodeError) as error:
            self._fail(_reason(error, self.folder))
        finally:
            if self.state not in ("finished", "failed"):  # our own fault; Python prints where
                self._fail("internal error, see the log")
            if self._signals is not None:
                self._signals.close()

    def _open(self) -> None:
        manifest = self._next_manifest()
        data = save_manifest(manifest, self.folder) if manifest else b""
        self._signals = SignalsFile(self.folder / layout.ACTIVE, self.anchor, self._facts, data)
        sync_folder(self.folder)

    def _work(self) -> None:
        """Write batches until asked to finish; flush by size, by time, and once after the first batch."""
        signals = self._opened()
        deadline = time.monotonic()
        while True:
            batches, is_closing = self._next_batches(deadline if signals.pending_bytes else None)
            for batch in batches:
                self._write(signals, batch)
                if signals.pending_bytes >= self._options.flush_bytes:
                    deadline = self._flush(signals)
            if signals.pending_bytes and time.monotonic() >= deadline:
                deadline = self._flush(signals)
            if self.state == "opening" and batches:
                self.state = "open"
            if (manifest := self._next_manifest()) is not None:
                save_manifest(manifest, self.folder)
            if is_closing:
                return

    def _write(self, signals: SignalsFile, batch: _Batch) -> None:
        for write in batch.writes:
            signals.add(write)
        self._position = batch.position or self._position
        with self._wake:
            self._queued_writes -= len(batch.writes)
            self._queued_bytes -= batch.size
        if batch.is_live and batch.writes:
            self.lag.note(time.monotonic_ns() - batch.writes[0][3])

    def _flush(self, signals: SignalsFile) -> float:
        """Bring everything to the disk and say so in the resume file; return when the next flush is due."""
        signals.sync()
        point = ResumePoint(
            episode_id=self._episode_id,
            position=self._position,
            size=signals.size,
            messages=signals.messages,
            anchor=self.anchor,
            wall_ns=time.time_ns(),
        )
        write_atomic(self.folder / layout.RESUME, msgspec.json.encode(point), sync=False)
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
        summary = {
            "messages": str(totals.messages),
            "dropped": str(totals.dropped),
            "lost": str(sum(stream.lost for stream in totals.streams)),
            "streams": msgspec.json.encode(totals.streams).decode(),
        }
        signals.finish(dump_manifest(manifest), summary)
        (self.folder / layout.ACTIVE).rename(self.folder / layout.SIGNALS)
        sync_folder(self.folder)
        manifest.recorder.bytes = signals.size
        save_manifest(manifest, self.folder)
        (self.folder / layout.RESUME).unlink(missing_ok=True)
        self.state = "finished"

    def totals(self) -> Totals:
        """Return the counters of the file; exact once the state is ``finished`` or ``failed``."""
        signals = self._signals
        channels = list(signals.channels) if signals else []
        counted = [channel for channel in channels if channel.count]
        return Totals(
            messages=signals.messages if signals else 0,
            bytes=signals.size if signals else 0,
            dropped=self.dropped + (signals.refused if signals else 0),
            first_ns=min((channel.first_ns for channel in counted), default=0),
            last_ns=max((channel.last_ns for channel in counted), default=0),
            streams=[channel.stream(self.anchor.wall_ns) for channel in channels],
            lag_p50_ms=self.lag.percentile_ms(50),
            lag_p99_ms=self.lag.percentile_ms(99),
        )

    def _next_batches(self, deadline: float | None) -> tuple[list[_Batch], bool]:
        """Wait for work, at most until the deadline; return the batches and whether they are the last."""
        with self._wake:
            if not self._has_work():
                self._wake.wait(None if deadline is None else max(0.0, deadline - time.monotonic()))
        if self._queued_writes < _HURRY_WRITES and self._closing is None:
            time.sleep(_LINGER_S)
        with self._wake:
            batches = list(self._queue)
            self._queue.clear()
            return batches, self._closing is not None

    def _has_work(self) -> bool:
        return bool(self._queue) or self._closing is not None or self._manifest is not None

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
                self.folder.rmdir()


def _reason(error: OSError | EpisodeError, folder: Path) -> str:
    if isinstance(error, OSError):
        return f"{error.strerror or error} ({error.filename or folder}); free the disk, then start a new episode"
    return str(error)
