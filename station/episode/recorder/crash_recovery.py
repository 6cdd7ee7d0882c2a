"""What a recorder that was killed leaves to the next one: an episode, and requests that were not answered."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from station.bus import keys
from station.bus.stamp import boot_id
from station.bus.tap import Position, Tap, Write
from station.episode.recorder.both_taps import cuts_of, open_taps
from station.episode.recorder.catching_up import CatchingUp
from station.episode.recorder.options import RecordingOptions
from station.episode.recorder.recording import Recording
from station.episode.recorder.resume import (
    Unfinished,
    as_written,
    last_requests,
    newest_closed,
    newest_start_ns,
    reopen,
    unfinished,
)
from station.episode.storage.left_open import (
    has_signals,
    is_left_open,
    not_begun,
    offer,
    remove_not_begun,
    remove_temporary,
)
from station.episode.storage.manifest_copy import find_manifest
from station.episode.storage.progress import ResumePoint, load_resume_point
from station.episode.storage.request import RecordAnswer, parse_answer, request_id
from station.episode.writing.closing import summary_of
from station.episode.writing.repair import Repaired, close_whole
from station.errors import BusError, EpisodeError
from station.life.restarts import RESTARTS_VARIABLE

if TYPE_CHECKING:
    from station.life.server import Life

_PATIENCE_S = 20.0  # as long as an asker waits for the recorder's answer
_READ_S = 0.02


class UnopenedEpisode(NamedTuple):
    """An episode whose start was asked for, and of which there is no more than where that stands in the stream."""

    folder: Path
    point: ResumePoint

    def is_recent(self, now_ns: int) -> bool:
        """Whether, at an instant [ns, monotonic], its asker may still wait for the answer; never in another boot."""
        age_s = (now_ns - self.point.mono_ns) * 1e-9
        return self.point.anchor.boot == boot_id() and 0 <= age_s < _PATIENCE_S


class CrashRecovery:
    """Looks at what is there before the tap is open, and hands it over when it is.

    Args:
        options: Where, and how to write.
        life: Says what was found.
        take_up_s: How long after its recorder died an episode is taken up again with a hole [s].
    """

    def __init__(self, options: RecordingOptions, life: Life, take_up_s: float) -> None:
        self._options = options
        self._life = life
        self._take_up_s = take_up_s
        self._clock = life.clock
        self._began_ns = self._clock.monotonic_ns()
        self._closed: list[Repaired] = []
        self._ended: list[Unfinished | UnopenedEpisode] = []  # followed by another episode: to be closed, oldest first
        self._found: Unfinished | None = None  # left open, and the last one
        self._done: ResumePoint | None = None  # of the last one, if we closed it: what was asked behind it comes again
        self._unborn: UnopenedEpisode | None = None  # an episode that was asked for, and of which nothing is there
        self._was_killed = life.bus.get(keys.RECORDER) is not None  # one that ends by itself takes its word away
        self._find()

    @property
    def position(self) -> Position | None:
        """Where the tap is to go on; None for anywhere."""
        return self._point.position if self._point else None

    @property
    def start_ns(self) -> int:
        """When the episode was begun that goes on, or that is yet to begin [ns, monotonic]; 0 for none."""
        return self._point.anchor.mono_ns if self._point else 0

    @property
    def saved_ns(self) -> int:
        """When that position was saved [ns, monotonic]; now, where there is none."""
        return self._point.mono_ns if self._point else self._began_ns

    @property
    def _point(self) -> ResumePoint | None:
        found = self._unborn or self._found
        return found.point if found else self._done

    def finish_ended(self, recording: Recording, backend: str | None) -> None:
        """Close the episodes that their recorder had ended and not closed, each with what the bus still has of it.

        The stream that goes on begins with a later episode, so each is read from a tap of its own. One of which the bus
        no longer has all is left for a repair.

        Args:
            recording: Takes them up one after the other; none is being recorded when this returns.
            backend: As for `open_tap`.
        """
        later = {found.point.start_id for found in (*self._ended, self._found, self._unborn) if found is not None}
        for found in self._ended:
            try:
                bus, point = self._life.bus, found.point
                tap = open_taps(
                    bus.address, bus.bulk_address, resume=point.position, backend=backend, since_ns=point.mono_ns,
                    offset_of=self._options.writer.offset_of,
                )  # fmt: skip
            except BusError as error:
                self._life.event("episode-not-closed", severity="warning", reason=str(error))
                continue
            try:
                if tap.resumed:
                    self._finish(found, recording, tap, later)
            finally:
                tap.close()

    def enter(self, recording: Recording, tap: Tap) -> int:
        """Hand an episode over that can go on, and tell of episodes that cannot.

        Returns:
            When the last write arrived that the episode holds [ns, monotonic]; 0 without one.
        """
        written_ns = 0
        for done in self._closed:
            summary = _ended_before(recording, Path(done.path), done.requests)
            self._life.event("record-stop", episode_id=done.episode_id, closed_by="the next recorder", **summary)
        if (
            self._was_killed
            and (folder := newest_closed(self._options.data, self._clock.wall_ns(), _PATIENCE_S)) is not None
        ):
            with contextlib.suppress(EpisodeError, OSError):  # closed by another process, or damaged since
                _ended_before(recording, folder, last_requests(folder))
        is_exact = tap.resumed is True
        if self._unborn is not None:
            if is_exact:  # the start comes with the stream, and before it what is its pre-roll
                recording.ignore_until(self._unborn.point.start_id, self._unborn.folder)
            else:
                remove_not_begun(self._unborn.folder)
        elif self._found is not None and (is_exact or self._found.age_s(self._clock.monotonic_ns()) <= self._take_up_s):
            written_ns = self._resume(self._found, recording, tap, is_exact=is_exact)
        if (line := offer(self._options.data)) is not None:
            self._life.event("episodes-left-open", severity="warning", reason=line)
        return written_ns

    def see_to_request(self, recording: Recording, *, is_in_stream: bool) -> None:
        """Do the newest request unless it was done, or is old, or comes with the stream; answer where that is due."""
        bus = self._life.bus
        request = bus.read([keys.RECORD]).get(keys.RECORD)
        if request is None:
            return
        asker, answer = request_id(request.value), bus.get(keys.RECORD_ACK)
        is_answered = answer is not None and parse_answer(answer, asker) is not None
        if recording.answers.knows(asker):
            if not is_answered:
                recording.answers.is_new(asker)  # which gives the answer once more
            return
        if is_in_stream:
            return
        mark = request.stamp
        written_ns = mark.mono_ns if mark is not None and mark.is_from_this_boot else 0
        is_for_us = written_ns >= self._began_ns  # the stream may bring it as well: then it is known
        is_left = self._was_killed and self._clock.monotonic_ns() - written_ns < _PATIENCE_S * 1e9
        if written_ns and (is_for_us or is_left) and not is_answered:
            recording.missed(Write(keys.RECORD, request.value, None, self._clock.monotonic_ns()))
        else:
            recording.seed(keys.RECORD, request.value, None)

    def _find(self) -> None:
        data, restarts = self._options.data, os.environ.get(RESTARTS_VARIABLE)
        unopened = self._unborn_in(data)
        left: list[Unfinished] = []
        closed: list[ResumePoint] = []
        begun_ns = [_began_ns(one) for one in unopened]  # by the monotonic clock
        for folder in data.glob("*/*/"):
            if not is_left_open(folder):
                continue
            point = load_resume_point(folder)
            if point is not None and point.anchor.boot == boot_id():
                begun_ns.append(point.anchor.mono_ns)
            try:
                if has_signals(folder) and (done := close_whole(folder)) is not None:
                    self._closed.append(done)
                    closed += [point] if point is not None else []
                elif (found := unfinished(folder, str(self._life.bus.address))) is not None:
                    left.append(found)
            except (EpisodeError, OSError) as error:
                self._life.event("episode-not-closed", severity="warning", reason=str(error))
        # A station that starts anew begins its own episode; one whose recorder alone died goes on with the old one.
        if restarts == "0":
            return
        left = [found for found in left if restarts is None or found.age_s(self._began_ns) <= self._take_up_s]
        newest_ns = max([*begun_ns, newest_start_ns(data)], default=0)
        self._found = next((found for found in left if _began_ns(found) == newest_ns), None)
        self._unborn = next((found for found in unopened if _began_ns(found) == newest_ns), None)
        self._done = next((point for point in closed if point.anchor.mono_ns == newest_ns), None)
        those: list[Unfinished | UnopenedEpisode] = [*left, *unopened]
        self._ended = sorted((one for one in those if _began_ns(one) != newest_ns), key=_began_ns)

    def _unborn_in(self, data: Path) -> list[UnopenedEpisode]:
        """Return the episodes that were to begin; folders that tell nothing, or of starts that are old, are removed."""
        found: list[UnopenedEpisode] = []
        for folder in not_begun(data):
            remove_temporary(folder)
            point = load_resume_point(folder)
            if (
                point is None
                or not (one := UnopenedEpisode(folder, point)).is_recent(self._clock.monotonic_ns())
                or os.environ.get(RESTARTS_VARIABLE) == "0"
            ):
                remove_not_begun(folder)
            else:
                found.append(one)
        return found

    def _finish(
        self, found: Unfinished | UnopenedEpisode, recording: Recording, tap: Tap, later: Collection[str]
    ) -> None:
        """Resume an episode, or begin it; read its tap up to its end, and have it closed."""
        written_ns = 0
        if isinstance(found, UnopenedEpisode):
            recording.placed(tap.position())
            recording.ignore_until(found.point.start_id, found.folder)
        else:
            written_ns = self._resume(found, recording, tap, is_exact=True)
        written_ns = written_ns or _began_ns(found)
        pace = CatchingUp(tap, self._clock.monotonic_s(), self._life.event)
        try:
            while recording.is_recording or recording.is_ignoring:
                recording.poll()
                must_wait = pace.must_wait(recording.load, self._clock.monotonic_s(), written_ns * 1e-9)
                if must_wait and not self._clock.wait(self._life.stop_event, _READ_S):
                    continue
                writes = as_written(tap.read(_READ_S), written_ns, self._options.writer.offset_of)
                for cut in cuts_of(tap):
                    recording.bulk_cut(cut)
                if writes:
                    written_ns = writes[-1].mono_ns
                    recording.feed_to_the_end(writes, tap.position(), later)
                if not tap.is_catching_up and (not writes or written_ns > self._began_ns):
                    break  # nothing said where it ended, and that was before we began
        except BusError as error:
            recording.hole(
                written_ns, self._clock.monotonic_ns(), f"the tap was lost before the episode's end: {error}"
            )
        recording.ignore_until("", found.folder)
        recording.finish("killed")

    def _resume(self, found: Unfinished, recording: Recording, tap: Tap, *, is_exact: bool) -> int:
        place = found.point.position if is_exact else tap.position()
        try:
            taken = reopen(found, self._options, place=place, is_exact=is_exact, clock=self._clock)
        except (EpisodeError, OSError) as error:
            self._life.event("episode-not-taken-up", severity="error", episode_id=found.folder.name, reason=str(error))
            return 0
        recording.resume(taken.take, taken.requests, awaited=taken.awaited)
        note = taken.take.manifest.recovery[-1]
        self._life.event(
            "recorder-resumed", severity="warning", episode_id=found.folder.name, by=note["by"],
            away_s=note["away_s"], restarts=taken.take.manifest.recorder.restarts, messages=note["kept_messages"],
        )  # fmt: skip
        return taken.written_ns


def _ended_before(recording: Recording, folder: Path, requests: list[str]) -> dict[str, Any]:
    """Have those that ended an episode answered as its own recorder would have; returns the summary."""
    manifest = find_manifest(folder).manifest
    summary = summary_of(manifest)
    answer = RecordAnswer(id="", ok=True, episode_id=manifest.episode_id, path=str(folder), summary=summary)
    recording.ended_before(answer, requests)
    return summary


def _began_ns(found: UnopenedEpisode | Unfinished) -> int:
    return found.point.anchor.mono_ns
