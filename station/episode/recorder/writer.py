"""Writes an episode in a thread behind a bounded queue, so that a slow disk never holds up the reader of the bus."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from station.bus.contracts import Contracts
from station.clock import SYSTEM, Clock
from station.episode.recorder.queue import Batch, WriteQueue
from station.episode.storage import layout
from station.episode.storage.anchor import Anchor
from station.episode.storage.channels import MAX_CHANNELS
from station.episode.storage.disk import give_back, why_not
from station.episode.storage.drops import DropPeriods
from station.episode.storage.manifest import Manifest, dump_manifest, facts_of, save_manifest, snapshot
from station.episode.storage.progress import ResumePoint, Totals, WriterOptions, save_resume_point
from station.episode.writing.checkpoint import EVERY_S, save_checkpoints
from station.episode.writing.closing import note_files, summary_record
from station.episode.writing.file import FarTimes
from station.episode.writing.files import EpisodeFiles, Lag
from station.errors import EpisodeError
from station.life.events import Severity

if TYPE_CHECKING:
    from station.bus.tap import Position, Write
    from station.episode.writing.files import EpisodeFiles


log = logging.getLogger(__name__)

_LINGER_S = 0.004  # taking writes in handfuls halves the CPU at 10 000 a second, and they are not waited for
_HURRY_WRITES = 2000

WriterState = Literal["opening", "open", "finishing", "finished", "failed"]


Closing = Callable[[Totals], Manifest]
"""Given the counters of the file, returns the manifest that closes it; called in the writer's thread."""


class EpisodeWriter:
    """Writes one episode into its folder. Every method returns at once, except `wait`.

    Args:
        folder: The episode's folder, already made.
        anchor: Clock of the file.
        manifest: What is known before the first write.
        options: How to write.
        start_id: Id of the request that began the episode, for the recorder that takes it up again.
        place: Where the tap stood before the first write, for the same.
        reopened: The files of an episode that is taken up again; None makes new ones.
        clock: The recorder's.

    A disk that is full or gone never raises here: `state` becomes ``failed`` and `error` says why in one line, what
    comes later is counted as dropped, and the ``.active`` files keep every flush that succeeded.

    Attributes:
        state: ``opening`` until the head of the file and the first batch are on the disk.
        error: Why it failed, "" otherwise.
        dropped: Writes that are not and will not be in the file.
    """

    def __init__(
        self, folder: Path, *, anchor: Anchor, manifest: Manifest, options: WriterOptions | None = None,
        start_id: str = "", place: Position | None = None, reopened: EpisodeFiles | None = None,
        contracts: Contracts | None = None, clock: Clock = SYSTEM,
    ) -> None:  # fmt: skip
        self.folder = folder
        self.anchor = anchor
        self.clock = clock
        self.state: WriterState = "opening"
        self.error = ""
        self.dropped = reopened.drops.total if reopened else 0
        self.lag = Lag()
        self._options = options or WriterOptions()
        self._queue = WriteQueue(self._options.queue_writes, self._options.queue_bytes)
        self._wake = threading.Condition()
        self._spells = {True: DropPeriods("images-dropped", "warning"), False: DropPeriods("writes-dropped", "error")}
        self._is_refusal_told = False
        self._saved = snapshot(manifest)
        self._manifest: Manifest | None = self._saved
        self._episode_id = manifest.episode_id
        self._facts = facts_of(manifest)
        self._closing: Closing | None = None
        self.contracts = contracts or Contracts(manifest.servers.values())
        if reopened is not None:
            reopened.contracts, reopened.far = self.contracts, FarTimes(self._options.offset_of)
        self._files = reopened
        self._ledger = Ledger(folder, manifest.episode_id, anchor, start_id, clock)
        self._position = place
        self._is_whole = True  # the position is that of the last write; never flushed in between
        self._thread = clock.start(self._run, f"writer {manifest.episode_id}")

    def put(
        self, writes: Sequence[Write], *, position: Position | None = None, is_live: bool = True,
        is_whole: bool = True, is_held: bool = False,
    ) -> int:  # fmt: skip
        """Queue writes in the order of their arrival; return how many were dropped, images before signals.

        Args:
            writes: What the tap returned; not to be changed afterwards.
            position: The tap's position after the last of them; saved once they are on the disk.
            is_live: False for the pre-roll, whose age says nothing about the writer.
            is_whole: False when more must follow before the position is known; nothing is flushed until then, since
                a recorder that is killed and resumes at a position must find exactly what came before it.
            is_held: Whether they are in memory anyway, as the pre-roll is: they take no room in the queue.
        """
        with self._wake:
            if self.state in ("failed", "finished") or self._closing is not None:
                self.dropped += len(writes)
                return len(writes)
            was_idle = not self._queue
            drops = self._queue.put(Batch(writes, 0, position, is_live, is_whole, is_held))
            if was_idle:
                self._wake.notify()
            if drops is None:
                return 0
            self.dropped += drops.total
        for is_bulky, spell in self._spells.items():
            spell.add(drops.only(is_bulky=is_bulky), self.clock.monotonic_s())
        return drops.total

    def news(self) -> Iterator[tuple[str, Severity, dict[str, Any]]]:
        """Return events that are due: writes are dropped, or no longer. For the thread that calls `put`."""
        for spell in self._spells.values():
            yield from spell.poll(self.clock.monotonic_s())
        if self.refused and not self._is_refusal_told:
            self._is_refusal_told = True
            yield "keys-refused", "error", {"channels": MAX_CHANNELS, "dropped": self.refused}

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
        self.clock.join(self._thread, timeout_s)
        return not self._thread.is_alive()

    @property
    def messages(self) -> int:
        """Messages in the files so far."""
        return self._files.messages if self._files else 0

    @property
    def size(self) -> int:
        """Bytes of the files on the disk so far."""
        return self._files.size if self._files else 0

    @property
    def refused(self) -> int:
        """Writes that are not in the file because it has too many keys already; not in `dropped`."""
        return self._files.refused if self._files else 0

    @property
    def queued(self) -> int:
        """Writes that wait for the disk."""
        return self._queue.writes

    @property
    def load(self) -> float:
        """How full the queue is, 0..1; from a half on bulky values are dropped."""
        return self._queue.load

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
            if self._files is not None:
                self._files.close()

    def _open(self) -> None:
        if self._files is None:
            self._ledger.record(
                self._position, None
            )  # before all else: no recorder goes on with what is there without it
        manifest = self._next_manifest()
        data = save_manifest(manifest, self.folder) if manifest else b""
        if self._files is None:
            self._files = EpisodeFiles.create(self.folder, self.anchor, self._facts, data)
            self._files.contracts, self._files.far = self.contracts, FarTimes(self._options.offset_of)
        else:
            self.state = "open"
        self._ledger.record(self._position, self._files)

    def _work(self) -> None:
        """Write batches until asked to finish; flush by size, by time, and once after the first batch."""
        files = self._opened()
        deadline = self.clock.monotonic_s()
        while True:
            batches, is_closing = self._next_batches(deadline if files.pending_bytes else None)
            if (manifest := self._next_manifest()) is not None:  # before what follows it: a hole, then the writes
                save_manifest(manifest, self.folder)
            for batch in batches:
                self._write(files, batch)
                if files.pending_bytes >= self._options.flush_bytes and self._is_whole:
                    deadline = self._flush(files)
            if files.pending_bytes and self.clock.monotonic_s() >= deadline and self._is_whole:
                deadline = self._flush(files)
            if self.state == "opening" and batches and self._is_whole:
                self.state = "open"
            if is_closing:
                return

    def _write(self, files: EpisodeFiles, batch: Batch) -> None:
        files.add(batch.writes)
        if batch.drops is not None:
            files.drops.add(batch.drops)
        self._is_whole = batch.is_whole
        if batch.is_whole:
            self._position = batch.position
        with self._wake:
            self._queue.done(batch)
        if batch.is_live and batch.writes:
            self.lag.add(self.clock.monotonic_ns() - batch.writes[0][3])

    def _flush(self, files: EpisodeFiles) -> float:
        """Bring everything to the disk and say so in the ledger; return when the next flush is due."""
        files.sync()
        self._ledger.record(self._position, files)
        return self.clock.monotonic_s() + self._options.flush_s

    def _close(self) -> None:
        files = self._opened()
        self.state = "finishing"
        files.sync()
        totals = self.totals()
        closing = self._closing
        if closing is None:
            raise RuntimeError("closing an episode that was not asked to finish")
        manifest = closing(totals)
        files.finish(dump_manifest(manifest), summary_record(totals))
        files.name()
        note_files(manifest, self.folder)  # whoever is killed before leaves it to the repair
        save_manifest(manifest, self.folder)
        give_back(self.folder)
        self._ledger.remove()  # last: by it all see that something is left to do
        self.state = "finished"

    def totals(self) -> Totals:
        """Return the counters of the files; exact once the state is ``finished`` or ``failed``."""
        if self._files is None:
            return Totals(dropped=self.dropped)
        return self._files.totals(self.dropped, self.lag)

    def _next_batches(self, deadline: float | None) -> tuple[list[Batch], bool]:
        """Wait for work, at most until the deadline; return some batches and whether they are the last."""
        with self._wake:
            left_s = None if deadline is None else max(0.0, deadline - self.clock.monotonic_s())
            self.clock.wait_for(self._wake, lambda: self._has_work, left_s)
        if self._queue.writes < _HURRY_WRITES and self._closing is None:
            self.clock.sleep(_LINGER_S)
        with self._wake:
            return self._queue.pop(self._options.flush_bytes), self._closing is not None and not self._queue

    @property
    def _has_work(self) -> bool:
        return bool(self._queue) or self._closing is not None or self._manifest is not None

    def _next_manifest(self) -> Manifest | None:
        with self._wake:
            manifest, self._manifest = self._manifest, None
            self._saved = manifest or self._saved
            return manifest

    def _opened(self) -> EpisodeFiles:
        if self._files is None:
            raise RuntimeError("the files are not open")
        return self._files

    def _fail(self, reason: str) -> None:
        error = f"episode {self._episode_id}: cannot be written any more: {reason}"
        log.error("%s", error)
        with self._wake:
            self.dropped += self._queue.clear() + (self._files.unsynced_messages if self._files else 0)
        self._saved.state = "failed"
        self._saved.recorder.ended_by, self._saved.recorder.dropped = error, self.dropped + self.refused
        give_back(self.folder)
        try:
            if self.folder.is_dir():  # one that is gone is not to become a file
                save_manifest(self._saved, self.folder)
        except EpisodeError as why:
            log.error("%s", why)
            with contextlib.suppress(OSError):  # of an episode that could not even begin, leave nothing; else keep all
                self._ledger.remove()
                self.folder.rmdir()
        with self._wake:  # last: who sees it finds the folder as it will stay
            self.error, self.state = error, "failed"
            self.dropped += self._queue.clear()


class Ledger:
    """Keeps the two small files of one episode up to date.

    Args:
        folder: Folder of the episode.
        episode_id, anchor, start_id: As in `ResumePoint`.
        clock: The recorder's.
    """

    def __init__(self, folder: Path, episode_id: str, anchor: Anchor, start_id: str, clock: Clock = SYSTEM) -> None:
        self._clock = clock
        self._folder = folder
        self._episode_id = episode_id
        self._anchor = anchor
        self._start_id = start_id
        self._due = self._clock.monotonic_s() + EVERY_S

    def record(self, position: Position | None, files: EpisodeFiles | None) -> None:
        """Record how far the files are safe, right after a flush; None for files that are not there yet.

        Raises:
            OSError: the disk refused it.
        """
        point = ResumePoint(
            episode_id=self._episode_id,
            position=position,
            size=files.signals.size if files else 0,
            cameras_size=files.size_of(layout.CAMERAS_NAMES) if files else 0,
            clouds_size=files.size_of(layout.CLOUDS_NAMES) if files else 0,
            messages=files.messages if files else 0,
            anchor=self._anchor,
            wall_ns=self._clock.wall_ns(),
            mono_ns=self._clock.monotonic_ns(),
            dropped=files.drops.total if files else 0,
            drops=list(files.drops) if files else [],
            start_id=self._start_id,
        )
        save_resume_point(point, self._folder)
        now = self._clock.monotonic_s()
        if files is not None and now >= self._due:
            self._due = now + EVERY_S
            save_checkpoints(files.checkpoints(), self._folder)

    def remove(self) -> None:
        """Remove both: the episode is closed."""
        for name in (layout.RESUME, layout.CHECKPOINT):
            (self._folder / name).unlink(missing_ok=True)
