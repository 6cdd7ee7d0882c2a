"""What a recorder does about requests: begins and ends episodes, answers, tells events."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from station.bus import stamp
from station.clock import SYSTEM, Clock
from station.episode.recorder.active_episode import ActiveEpisode
from station.episode.recorder.disk_space import DiskSpace
from station.episode.recorder.latched import believed
from station.episode.recorder.options import Notice, RecordingOptions
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage.anchor import Anchor, iso, read_anchor
from station.episode.storage.folder import new_folder
from station.episode.storage.manifest import Manifest, Recorder, Task, Timing, save_manifest
from station.episode.storage.manifest_copy import manifest_to_change
from station.episode.storage.request import RecordAnswer, RecorderState, RecordRequest, parse_request, request_id
from station.episode.writing.servers_seen import ServersSeen
from station.errors import EpisodeError, Refused
from station.life.events import Severity
from station.software import software

if TYPE_CHECKING:
    from station.bus.tap import Position, Write
    from station.episode.recorder.both_taps import Cut


_REMEMBERED = 64
_MOST_DUE = 256  # of a flood of requests the newest are answered: the askers of the others have stopped waiting


_WRITE_BYTES = 300  # of a write with its stamp, beside its value
_PARTS = 4


class Answers:
    """Queue of answers, with a memory of the newest requests."""

    def __init__(self) -> None:
        self._due: deque[RecordAnswer] = deque(maxlen=_MOST_DUE)
        self._known: dict[str, RecordAnswer | None] = {}

    def is_new(self, asker: str | None) -> bool:
        """Whether a request was not seen before; one whose answer may have been lost gets it again."""
        if asker is None:
            return True
        if asker not in self._known:
            self._remember(asker, None)
            return True
        answer = self._known[asker]
        if answer is not None:
            self._due.append(answer)
        return False

    def knows(self, asker: str | None) -> bool:
        """Whether a request was seen before."""
        return asker in self._known

    def remember(self, asker: str, answer: RecordAnswer | None = None) -> None:
        """Count a request as seen, and answered so should it come again; None leaves it without an answer."""
        self._remember(asker, answer)

    def give(self, answer: RecordAnswer) -> None:
        """Have an answer published."""
        self._remember(answer.id, answer)
        self._due.append(answer)

    def next(self) -> RecordAnswer | None:
        """Return the oldest answer that is to be published, or None."""
        return self._due.popleft() if self._due else None

    def pop(self) -> list[RecordAnswer]:
        """Return what is to be published, oldest first; it is then taken as published."""
        due = list(self._due)
        self._due.clear()
        return due

    def _remember(self, asker: str, answer: RecordAnswer | None) -> None:
        self._known[asker] = answer
        while len(self._known) > _REMEMBERED:
            del self._known[next(iter(self._known))]


_MOST_CLOSING = 8  # each holds a queue and a thread until the disk lets go of it
_MOST_NOTICES = 256  # that wait; of a flood of requests, each of which is refused, the newest are told
_NONE = "no episode is being recorded"
_ENDING = ("stop", "discard")


class RecorderController:
    """What is recorded now, what is being closed, and which requests wait for an answer.

    Attributes:
        answers: Answers that are to be published; the owner takes them out.
        notices: Events that are to be published, likewise.
        tap: What the manifest says of the tap in use: backend, losslessness, address of the bus.
        room: Whether the disk has room for an episode; to be told what is written on the bus.
        claim: Called before an episode begins; raises `Refused` where the data folder is another recorder's by now.
    """

    def __init__(self, options: RecordingOptions, tap: Recorder, clock: Clock = SYSTEM) -> None:
        self.options, self.clock = options, clock
        self.answers = Answers()
        self.notices: deque[Notice] = deque(maxlen=_MOST_NOTICES)
        self.tap = tap
        self.room = DiskSpace(options, clock)
        self.claim: Callable[[], None] = lambda: None
        self._heard = ServersSeen()
        self._ring = Ring(options.preroll_s, options.preroll_bytes)
        self._latched: dict[str, bytes | None] = {}  # stamps of states that stood on the bus when the tap was opened
        self._position: Position | None = None  # of the tap, behind what it returned so far
        self._awaited = ""  # id of a start request that is to come once more, with what came before and behind it
        self._ignored_until = ""  # id of a start request, see `ignore_until`
        self._reserved: tuple[str, Path] | None = None  # likewise, with the folder
        self._bulk_lost: Cut | None = None  # while the bulk bus is not heard
        self._bulk_hole: Cut | None = None  # the newest that is over
        self._active: ActiveEpisode | None = None
        self._closing: list[ActiveEpisode] = []
        self._last_folder: Path | None = None
        self._last_error = ""

    def poll(self) -> None:
        """Do everything that does not come with a write: answers that became due, disks that failed."""
        take = self._active
        if take is not None:
            take.save_if_due()
            self._answer_start(take)
            for name, severity, numbers in take.writer.news():
                self._notice(name, severity, episode_id=take.episode_id, **numbers)
            if take.writer.state == "failed":
                self._give_up(take)
            elif self.room.is_used_up:
                self._end_in_time(take)
        size = self._active.writer.size if self._active is not None else None
        for news in self.room.follow(size):
            self._notice(news.name, news.severity, **self._which(), **news.numbers)
        for closing in [closing for closing in self._closing if closing.is_over]:
            self._closing.remove(closing)
            self._answer_start(closing)
            self._answer_end(closing)

    def resume(self, take: ActiveEpisode, requests: Sequence[str], *, awaited: str = "") -> None:
        """Go on with an episode whose recorder died.

        Args:
            take: The episode, open again.
            requests: Ids of the requests that its file holds: done before, and not to be done again.
            awaited: Id of its start request where the file does not hold that yet: the stream is to bring it again,
                with the pre-roll before it.
        """
        self._active, self._awaited = take, awaited
        self._heard.contracts = take.writer.contracts
        self._heard.fill(take.manifest)
        for asker in requests:
            self.answers.remember(asker, take.answer(asker))

    def ignore_until(self, start_id: str, folder: Path) -> None:
        """Do no request before a certain start comes by: what comes before it was done by the recorder before us.

        Args:
            start_id: Id of the start.
            folder: The folder that was made for its episode, and is to be used.
        """
        self._ignored_until, self._reserved = start_id, (start_id, folder)

    def ended_before(self, answer: RecordAnswer, requests: Sequence[str]) -> None:
        """Publish an episode whose recorder died while it closed it, and which is whole."""
        self._last_folder = Path(answer.path or "")
        for asker in requests:
            self.answers.remember(asker, msgspec.structs.replace(answer, id=asker))

    def finish(self, ended_by: str) -> None:
        """End the present episode, if there is one."""
        if self._active is not None:
            self._end(self._active, ended_by, self.clock.monotonic_ns())

    def close(self, timeout_s: float = 10.0) -> bool:
        """End the present episode and wait until every file is closed; return whether all are."""
        self.finish("shutdown")
        deadline = self.clock.monotonic_s() + timeout_s
        for take in self._closing:
            take.writer.wait(max(0.0, deadline - self.clock.monotonic_s()))
        self.poll()
        self.room.close()
        return not self._closing

    def state(self) -> RecorderState:
        """Return what the recorder is doing now."""
        take = self._active
        if take is None:
            found = RecorderState(state="idle", backend=self.tap.backend, error=self._last_error)
        else:
            found = take.state(self.tap.backend)
        return msgspec.structs.replace(found, free_mb=self.room.free_mb, minutes_left=self.room.minutes_left)

    def _request(self, write: Write) -> None:
        if write.value is None:
            return
        asker = request_id(write.value)
        if self._ignored_until and asker != self._ignored_until:
            return
        self._ignored_until = ""
        if not self.answers.is_new(asker):
            return
        try:
            request = parse_request(write.value)
            act = {"start": self._start, "stop": self._stop, "mark": self._mark, "discard": self._discard}
            act[request.action](request, _written_ns(write) if request.action in _ENDING else write.mono_ns)
        except (Refused, EpisodeError) as error:
            self._notice("record-refused", "warning", reason=str(error))
            self.answers.give(RecordAnswer(id=asker or "", ok=False, reason=str(error)))

    def _start(self, request: RecordRequest, mono_ns: int) -> None:
        if self._active is not None:
            raise Refused(f"already recording {self._active.episode_id}; stop it first")
        if len(self._closing) >= _MOST_CLOSING:
            raise Refused(
                f"{len(self._closing)} episodes are still being closed: the disk does not keep up; wait for it"
            )
        reason = self._heard.missing_configuration(self.clock.monotonic_ns()) or self.room.refusal(request.planned_s)
        if reason is not None:
            raise Refused(reason)
        self.claim()
        task = request.task or self.options.task
        if self._reserved is not None and self._reserved[0] == request.id:
            folder = self._reserved[1]
        else:
            folder = new_folder(self.options.data, task, self._heard.robot_in_names)
        self._reserved = None
        now = read_anchor(self.clock)
        anchor = Anchor(wall_ns=now.at(mono_ns), mono_ns=mono_ns, boot=now.boot)
        manifest = Manifest(
            episode_id=folder.name,
            task=Task(name=task, instruction=request.instruction),
            operator=request.who(),
            timing=Timing(started=iso(anchor.wall_ns), anchor=anchor),
            runbook=request.runbook,
            recorder=msgspec.structs.replace(
                self.tap,
                software=msgspec.to_builtins(software()),
                config=self.options.config,
                leave_out=sorted({*self.options.leave_out, *request.leave_out}),
            ),
        )
        self._heard.fill(manifest)
        preroll = believed(self._ring.since(mono_ns), self._latched)
        writer = EpisodeWriter(
            folder, anchor=anchor, manifest=manifest, options=self.options.writer, start_id=request.id,
            place=self._ring.place(mono_ns) if preroll else self._position, contracts=self._heard.contracts,
            clock=self.clock,
        )  # fmt: skip
        self._active = ActiveEpisode(writer, manifest, start_id=request.id)
        self._active.begin(preroll)
        if self._bulk_hole is not None and self._bulk_hole.to_ns > self._preroll_from(self._active):
            self._tell_bulk_hole(self._active, self._bulk_hole, self._bulk_hole.to_ns)
        self.room.begin()
        self._last_error = ""

    def _stop(self, request: RecordRequest, mono_ns: int) -> None:
        take = self._present("stop")
        if request.success is not None:
            take.manifest.quality_flags.success = request.success
        take.manifest.runbook = request.runbook or take.manifest.runbook
        take.end_ids.append(request.id)
        self._end(take, "stop", mono_ns)

    def _mark(self, request: RecordRequest, mono_ns: int) -> None:
        take = self._present("mark")
        if not take.mark(request.label, mono_ns, request.success):
            raise Refused(f"episode {take.episode_id} has {len(take.manifest.marks)} marks already, which is the most")
        self._notice("mark", "info", episode_id=take.episode_id, label=request.label)
        self.answers.give(take.answer(request.id))

    def _discard(self, request: RecordRequest, mono_ns: int) -> None:
        if self._active is not None:
            take = self._active
            take.manifest.quality_flags.discarded = True
            if request.label:
                take.mark(f"discarded: {request.label}", mono_ns, None)
            take.end_ids.append(request.id)
            self._end(take, "discard", mono_ns)
        elif self._closing:
            self._closing[-1].discard_ids = [*self._closing[-1].discard_ids[-_MOST_NOTICES:], request.id]
        else:
            self.answers.give(self._discard_last(request.id))

    def _discard_last(self, asker: str) -> RecordAnswer:
        folder = self._last_folder
        if folder is None:
            raise Refused("nothing to discard: this recorder has recorded no episode yet")
        manifest = manifest_to_change(folder)
        manifest.quality_flags.discarded = True
        save_manifest(manifest, folder)
        self._notice("record-discard", "info", episode_id=folder.name)
        return RecordAnswer(id=asker, ok=True, episode_id=folder.name, path=str(folder))

    def _present(self, action: str) -> ActiveEpisode:
        if self._active is None:
            why = f"the last one ended by itself: {self._last_error}" if self._last_error else _NONE
            raise Refused(f"nothing to {action}: {why}; `station record start` begins one")
        return self._active

    def _end(self, take: ActiveEpisode, ended_by: str, mono_ns: int) -> None:
        self._active = None
        self._closing.append(take)
        if self._bulk_lost is not None:
            self._tell_bulk_hole(take, self._bulk_lost, mono_ns)
        take.finish(ended_by, max(mono_ns, take.anchor.mono_ns))

    def _tell_bulk_hole(self, take: ActiveEpisode, cut: Cut, to_ns: int) -> None:
        take.hole(max(cut.from_ns, self._preroll_from(take)), to_ns, cut.reason)

    def _preroll_from(self, take: ActiveEpisode) -> int:
        """Return when the oldest write of an episode may have been written [ns, monotonic]."""
        return take.anchor.mono_ns - int(self.options.preroll_s * 1e9)

    def _end_in_time(self, take: ActiveEpisode) -> None:
        """End an episode while the disk has room for its last words."""
        self._last_error = f"episode {take.episode_id}: {self.room.used_up}"
        self._notice("disk-full", "error", episode_id=take.episode_id, reason=self.room.used_up)
        self._end(take, "disk-full", self.clock.monotonic_ns())

    def _give_up(self, take: ActiveEpisode) -> None:
        self._active = None
        self._last_folder, self._last_error = take.folder, take.writer.error
        self._notice("record-failed", "error", episode_id=take.episode_id, reason=take.writer.error)

    def _answer_start(self, take: ActiveEpisode) -> None:
        """Answer the start once the head of the file is on the disk, or cannot be."""
        if take.start_id is None or take.writer.state == "opening":
            return
        asker, take.start_id = take.start_id, None
        if take.writer.state == "failed":
            self.answers.give(take.answer(asker, reason=take.writer.error))
            return
        self._notice("record-start", "info", episode_id=take.episode_id, path=str(take.folder))
        self.answers.give(take.answer(asker))

    def _answer_end(self, take: ActiveEpisode) -> None:
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
            try:
                self.answers.give(self._discard_last(asker))
            except EpisodeError as error:
                self.answers.give(take.answer(asker, reason=str(error)))

    def _which(self) -> dict[str, Any]:
        return {"episode_id": self._active.episode_id} if self._active is not None else {}

    def _notice(self, name: str, severity: Severity, **numbers: Any) -> None:
        self.notices.append(Notice(name, severity, numbers))


class Ring:
    """Writes of the last seconds, bounded by time and by bytes; what falls out at the old end is meant to.

    Args:
        seconds: How far back it reaches [s]; 0 keeps nothing.
        max_bytes: Bound of its memory; with fast cameras on the bus it reaches less far back. A value of more than a
            quarter of that is not kept: everything before it would have to go.
    """

    def __init__(self, seconds: float, max_bytes: int = 256 * 1024 * 1024) -> None:
        self._span_ns = int(seconds * 1e9)
        self._max_bytes = max_bytes
        self._batches: deque[tuple[Sequence[Write], int, Position | None]] = deque()
        self._bytes = 0

    @property
    def size(self) -> int:
        """Bytes that are kept."""
        return self._bytes

    def add(self, writes: Sequence[Write], before: Position | None = None) -> None:
        """Keep writes, in the order of their arrival; the sequence must not change afterwards.

        Args:
            writes: What arrived.
            before: A place of the tap that none of them lies before.
        """
        if not writes or not self._span_ns:
            return
        size = sum([len(write.value) for write in writes if write.value is not None])
        if size > self._max_bytes // _PARTS:
            writes = [write for write in writes if len(write.value or b"") <= self._max_bytes // _PARTS]
            size = sum(len(write.value or b"") for write in writes)
        if not writes:
            return
        size += _WRITE_BYTES * len(writes)
        self._batches.append((writes, size, before))
        self._bytes += size
        oldest_ns = writes[-1].mono_ns - self._span_ns
        while self._batches and (self._bytes > self._max_bytes or self._batches[0][0][-1].mono_ns < oldest_ns):
            self._bytes -= self._batches.popleft()[1]

    def since(self, mono_ns: int) -> list[Write]:
        """Return what is kept of the span that ends at a monotonic instant [ns], oldest first."""
        oldest_ns = mono_ns - self._span_ns
        return [write for writes, _, _ in self._batches for write in writes if write.mono_ns >= oldest_ns]

    def place(self, mono_ns: int) -> Position | None:
        """Return the tap's place before everything that `since` returns; None when nothing is kept, or no place."""
        oldest_ns = mono_ns - self._span_ns
        return next((before for writes, _, before in self._batches if writes[-1].mono_ns >= oldest_ns), None)

    def clear(self) -> None:
        """Forget everything: after a hole, what came before it must not pass for what came just before."""
        self._batches.clear()
        self._bytes = 0


def _written_ns(write: Write) -> int:
    """Return when a request was written; where its stamp is of another clock, or none, when it arrived [ns, monotonic].

    An episode ends when that was asked for: on a busy machine the recorder may hear of it a second later, and nothing
    that was written meanwhile is in the episode.
    """
    mark = stamp.decode(write.stamp) if write.stamp is not None else None
    return min(mark.mono_ns, write.mono_ns) if mark is not None and mark.is_from_this_boot else write.mono_ns
