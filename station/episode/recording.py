"""The recorder without its bus: writes in, episodes on disk, answers and events out.

Requests are taken from the stream of writes itself, so an episode begins and ends at an exact place of it.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from station.bus import keys
from station.episode.anchor import Anchor, take_anchor
from station.episode.answers import Answers
from station.episode.folder import new_folder
from station.episode.heard import Heard, is_motion
from station.episode.manifest import Manifest, Recorder, Task, Timing, load_manifest, save_manifest
from station.episode.options import Notice, RecordingOptions, no_space
from station.episode.request import RecordAnswer, RecorderState, RecordRequest, parse_request, request_id
from station.episode.ring import Ring
from station.episode.take import Take, iso
from station.errors import EpisodeError, Refused
from station.life.events import Severity
from station.software import software

if TYPE_CHECKING:
    from station.bus.tap import Position, Write

log = logging.getLogger(__name__)

_MOST_KEYS = 100_000  # of which we remember whether they matter; a client that invents keys must not fill the memory


class Recording:
    """A recorder's state. One thread feeds it and polls it; no call waits for the disk but for making a folder.

    Attributes:
        answers: Answers that are to be published; the owner takes them out.
        notices: Events that are to be published, likewise.
        tap: What the manifest says of the tap in use: backend, losslessness, address of the bus.
    """

    def __init__(self, options: RecordingOptions, *, backend: str, is_lossless: bool, bus: str = "") -> None:
        self.options = options
        self.answers = Answers()
        self.notices: deque[Notice] = deque()
        self.tap = Recorder(backend=backend, is_lossless=is_lossless, bus=bus)
        self._heard = Heard()
        self._ring = Ring(options.preroll_s, options.preroll_bytes)
        self._take: Take | None = None
        self._closing: list[Take] = []
        self._last_folder: Path | None = None
        self._last_error = ""
        self._known: dict[str, Callable[[Write], None] | None] = {}

    def seed(self, key: str, value: bytes, stamp: bytes | None) -> None:
        """Tell what a key held before the tap was opened: servers that are up, a request that is answered."""
        if key == keys.RECORD:
            self.answers.is_new(request_id(value))
        elif self._heard.is_of_interest(key):
            self._heard.hear(key, value, stamp, time.monotonic_ns())

    def missed(self, request: Write) -> None:
        """Do a request that was written while no tap was open, unless it was seen; the file does not hold it."""
        if request.value is not None and not self.answers.knows(request_id(request.value)):
            self._request(request)

    def feed(self, writes: Sequence[Write], position: Position | None = None) -> None:
        """Take in what the tap returned; `position` is the tap's place after the last of it."""
        done = 0
        for index, write in enumerate(writes):
            handle = self._handler(write.key)
            if handle is None:
                continue
            if write.key == keys.RECORD:
                self._advance(writes[done : index + 1], None)
                done = index + 1
            handle(write)
        self._advance(writes[done:], position)

    def poll(self) -> None:
        """Look after everything that does not come with a write: answers that became due, disks that failed."""
        take = self._take
        if take is not None:
            take.save_if_due()
            self._answer_start(take)
            if take.writer.state == "failed":
                self._give_up(take)
        for closing in [closing for closing in self._closing if closing.is_over]:
            self._closing.remove(closing)
            self._answer_start(closing)
            self._answer_end(closing)

    def hole(self, from_ns: int, to_ns: int, reason: str) -> None:
        """Say that writes between two instants [ns, monotonic] may be missing."""
        self._ring.clear()
        if self._take is not None:
            self._take.hole(from_ns, to_ns, reason)

    def retapped(self, backend: str, is_lossless: bool) -> None:
        """Say that another tap is in use from now on."""
        for recorder in [self.tap, *([self._take.manifest.recorder] if self._take else [])]:
            recorder.backend = backend if recorder.backend.endswith(backend) else f"{recorder.backend}, then {backend}"
            recorder.is_lossless &= is_lossless
        self.tap.backend, self.tap.is_lossless = backend, is_lossless

    def not_mirrored(self, count: int) -> None:
        """Say how many commands of others changed a key in a way that the tap cannot show."""
        if self._take is not None and self._take.manifest.recorder.not_mirrored != count:
            self._take.manifest.recorder.not_mirrored = count
            self._take.touch()

    def finish(self, ended_by: str) -> None:
        """End the present episode, if there is one."""
        if self._take is not None:
            self._end(self._take, ended_by, time.monotonic_ns())

    def close(self, timeout_s: float = 10.0) -> bool:
        """End the present episode and wait until every file is closed; return whether all are."""
        self.finish("shutdown")
        deadline = time.monotonic() + timeout_s
        for take in self._closing:
            take.writer.wait(max(0.0, deadline - time.monotonic()))
        self.poll()
        return not self._closing

    def state(self) -> RecorderState:
        """Return what the recorder is doing now."""
        take = self._take
        if take is None:
            return RecorderState(state="idle", backend=self.tap.backend, error=self._last_error)
        return take.state(self.tap.backend)

    def _handler(self, key: str) -> Callable[[Write], None] | None:
        try:
            return self._known[key]
        except KeyError:
            if len(self._known) >= _MOST_KEYS:
                self._known.clear()
            handle = self._known[key] = self._choose(key)
            return handle

    def _choose(self, key: str) -> Callable[[Write], None] | None:
        if key == keys.RECORD:
            return self._request
        if key == keys.EVENT or is_motion(key):
            return self._note
        return self._hear if self._heard.is_of_interest(key) else None

    def _advance(self, writes: Sequence[Write], position: Position | None) -> None:
        self._ring.add(writes)
        if self._take is not None and self._take.put(writes, position) and not self._take.has_dropped:
            self._take.has_dropped = True
            self._notice(
                "recorder-dropping", "error", episode_id=self._take.episode_id, queued=self._take.writer.queued
            )

    def _note(self, write: Write) -> None:
        if self._take is not None:
            self._take.note(write)

    def _hear(self, write: Write) -> None:
        if write.value is None:
            return
        self._heard.hear(write.key, write.value, write.stamp, write.mono_ns)
        if self._take is not None and write.key.startswith(keys.CONFIG_PREFIX):
            self._heard.fill(self._take.manifest)
            self._take.touch()

    def _request(self, write: Write) -> None:
        if write.value is None:
            return
        asker = request_id(write.value)
        if not self.answers.is_new(asker):
            return
        try:
            request = parse_request(write.value)
            {"start": self._start, "stop": self._stop, "mark": self._mark, "discard": self._discard}[request.action](
                request, write.mono_ns
            )
        except (Refused, EpisodeError) as error:
            self._notice("record-refused", "warning", reason=str(error))
            self.answers.give(RecordAnswer(id=asker or "", ok=False, reason=str(error)))

    def _start(self, request: RecordRequest, mono_ns: int) -> None:
        if self._take is not None:
            raise Refused(f"already recording {self._take.episode_id}; stop it first")
        reason = self._heard.missing_configuration(time.monotonic_ns()) or no_space(
            self.options.data, self.options.min_free_mb
        )
        if reason is not None:
            raise Refused(reason)
        task = request.task or self.options.task
        folder = new_folder(self.options.data, task, self._heard.robot)
        clock = take_anchor()
        anchor = Anchor(wall_ns=clock.at(mono_ns), mono_ns=mono_ns, boot=clock.boot)
        manifest = Manifest(
            episode_id=folder.name,
            task=Task(name=task, instruction=request.instruction),
            operator=request.who(),
            timing=Timing(started=iso(anchor.wall_ns), anchor=anchor),
            runbook=request.runbook,
            recorder=msgspec.structs.replace(
                self.tap, software=msgspec.to_builtins(software()), config=self.options.config
            ),
        )
        self._heard.fill(manifest)
        self._take = Take(folder, anchor, manifest, start_id=request.id, options=self.options.writer)
        self._take.begin(self._ring.since(mono_ns))
        self._last_error = ""

    def _stop(self, request: RecordRequest, mono_ns: int) -> None:
        take = self._present("stop")
        if request.success is not None:
            take.manifest.quality_flags.success = request.success
        take.end_ids.append(request.id)
        self._end(take, "stop", mono_ns)

    def _mark(self, request: RecordRequest, mono_ns: int) -> None:
        take = self._present("mark")
        if not take.mark(request.label, mono_ns, request.success):
            raise Refused(f"episode {take.episode_id} has {len(take.manifest.marks)} marks already, which is the most")
        self._notice("mark", "info", episode_id=take.episode_id, label=request.label)
        self.answers.give(take.answer(request.id))

    def _discard(self, request: RecordRequest, mono_ns: int) -> None:
        if self._take is not None:
            take = self._take
            take.manifest.quality_flags.discarded = True
            if request.label:
                take.mark(f"discarded: {request.label}", mono_ns, None)
            take.end_ids.append(request.id)
            self._end(take, "discard", mono_ns)
        elif self._closing:
            self._closing[-1].discard_ids.append(request.id)
        else:
            self.answers.give(self._discard_last(request.id))

    def _discard_last(self, asker: str) -> RecordAnswer:
        folder = self._last_folder
        if folder is None:
            raise Refused("nothing to discard: this recorder has recorded no episode yet")
        manifest = load_manifest(folder)
        manifest.quality_flags.discarded = True
        save_manifest(manifest, folder)
        self._notice("record-discard", "info", episode_id=folder.name)
        return RecordAnswer(id=asker, ok=True, episode_id=folder.name, path=str(folder))

    def _present(self, action: str) -> Take:
        if self._take is None:
            raise Refused(f"nothing to {action}: no episode is being recorded; `station record start` begins one")
        return self._take

    def _end(self, take: Take, ended_by: str, mono_ns: int) -> None:
        self._take = None
        self._closing.append(take)
        take.finish(ended_by, mono_ns)

    def _give_up(self, take: Take) -> None:
        self._take = None
        self._last_folder, self._last_error = take.folder, take.writer.error
        self._notice("record-failed", "error", episode_id=take.episode_id, reason=take.writer.error)

    def _answer_start(self, take: Take) -> None:
        """Answer the start once the head of the file is on the disk, or cannot be."""
        if take.start_id is None or take.writer.state == "opening":
            return
        asker, take.start_id = take.start_id, None
        if take.writer.state == "failed":
            self.answers.give(take.answer(asker, reason=take.writer.error))
            return
        self._notice("record-start", "info", episode_id=take.episode_id, path=str(take.folder))
        self.answers.give(take.answer(asker))

    def _answer_end(self, take: Take) -> None:
        self._last_folder = take.folder
        summary = take.summary()
        failed = take.writer.error if take.writer.state == "failed" else ""
        if failed:
            self._last_error = failed
            self._notice("record-failed", "error", episode_id=take.episode_id, reason=failed)
        else:
            self._notice("record-stop", "info", episode_id=take.episode_id, **summary)
        for asker in take.end_ids:
            self.answers.give(msgspec.structs.replace(take.answer(asker, reason=failed), summary=summary))
        for asker in take.discard_ids:
            self.answers.give(self._discard_last(asker))

    def _notice(self, name: str, severity: Severity, **numbers: Any) -> None:
        self.notices.append(Notice(name, severity, numbers))
