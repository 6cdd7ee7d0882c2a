"""What a recorder that was killed leaves to the next one: an episode, and requests that nobody has answered."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from station.atomic_file import remove_leftovers
from station.bus import keys
from station.bus.stamp import boot_id
from station.bus.tap import Position, Tap, Write
from station.episode.recorder.options import RecordingOptions
from station.episode.recorder.recording import Recording
from station.episode.recorder.resume import Unfinished, last_requests, newest, newest_closed, take_up
from station.episode.storage import layout
from station.episode.storage.left_open import has_signals, left_open, offer
from station.episode.storage.manifest_copy import find_manifest
from station.episode.storage.progress import ResumePoint, load_resume_point
from station.episode.storage.request import RecordAnswer, request_id
from station.episode.writing.closing import summary_of
from station.episode.writing.repair import Repaired, close_whole
from station.errors import EpisodeError
from station.life.restarts import RESTARTS_VARIABLE

if TYPE_CHECKING:
    from station.life.server import Life

_PATIENCE_S = 20.0  # as long as whoever asks a recorder waits for its answer


class Heritage:
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
        self._began_ns = time.monotonic_ns()
        self._closed: list[Repaired] = []
        self._found: Unfinished | None = None
        self._unborn: ResumePoint | None = None  # of an episode that was asked for, and of which nothing is there
        self._was_killed = life.bus.get(keys.RECORDER) is not None  # one that ends by itself takes its word away
        self._look()

    @property
    def position(self) -> Position | None:
        """Where the tap is to go on; None for anywhere."""
        return self._point.position if self._point else None

    @property
    def start_ns(self) -> int:
        """When the episode was begun that goes on, or that is yet to begin [ns, monotonic]; 0 for none."""
        return self._point.anchor.mono_ns if self._point else 0

    @property
    def _point(self) -> ResumePoint | None:
        return self._unborn or (self._found.point if self._found else None)

    def enter(self, recording: Recording, tap: Tap) -> int:
        """Hand an episode over that can go on, and tell of episodes that cannot.

        Returns:
            When the last write arrived that the episode holds [ns, monotonic]; 0 without one.
        """
        written_ns = 0
        for done in self._closed:
            summary = _ended_before(recording, Path(done.path), done.requests)
            self._life.event("record-stop", episode_id=done.episode_id, closed_by="the next recorder", **summary)
        if self._was_killed and (folder := newest_closed(self._options.data, _PATIENCE_S)) is not None:
            with contextlib.suppress(EpisodeError, OSError):  # closed by somebody else, or damaged since
                _ended_before(recording, folder, last_requests(folder))
        is_exact = tap.resumed is True
        if self._unborn is not None:
            if is_exact:  # the start comes with the stream, and before it what is its pre-roll
                recording.ignore_until(self._unborn.start_id)
        elif self._found is not None and (is_exact or self._found.age_s <= self._take_up_s):
            written_ns = self._take_up(self._found, recording, tap, is_exact=is_exact)
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
        is_answered = answer is not None and request_id(answer) == asker
        if recording.answers.knows(asker):
            if not is_answered:
                recording.answers.is_new(asker)  # which gives the answer once more
            return
        if is_in_stream:
            return
        mark = request.stamp
        written_ns = mark.mono_ns if mark is not None and mark.is_from_this_boot else 0
        is_for_us = written_ns >= self._began_ns  # the stream may bring it as well: then it is known
        is_left = self._was_killed and time.monotonic_ns() - written_ns < _PATIENCE_S * 1e9
        if written_ns and (is_for_us or is_left) and not is_answered:
            recording.missed(Write(keys.RECORD, request.value, None, time.monotonic_ns()))
        else:
            recording.seed(keys.RECORD, request.value, None)

    def _look(self) -> None:
        for folder in left_open(self._options.data):
            try:
                if not _has_begun(folder):
                    self._unborn = _forgotten(folder)
                elif has_signals(folder) and (done := close_whole(folder)) is not None:
                    self._closed.append(done)
            except (EpisodeError, OSError) as error:
                self._life.event("episode-not-closed", severity="warning", reason=str(error))
        found = newest(left_open(self._options.data), str(self._life.bus.address))
        restarts = os.environ.get(RESTARTS_VARIABLE)
        # A station that starts anew begins its own episode; one whose recorder alone died goes on with the old one.
        if restarts == "0":
            self._unborn = None
        elif found is not None and (restarts is None or found.age_s <= self._take_up_s):
            self._found = found

    def _take_up(self, found: Unfinished, recording: Recording, tap: Tap, *, is_exact: bool) -> int:
        place = found.point.position if is_exact else tap.position()
        try:
            taken = take_up(found, self._options, place=place, is_exact=is_exact)
        except (EpisodeError, OSError) as error:
            self._life.event("episode-not-taken-up", severity="error", episode_id=found.folder.name, reason=str(error))
            return 0
        recording.take_up(taken.take, taken.requests, awaited=taken.awaited)
        note = taken.take.manifest.recovery[-1]
        self._life.event(
            "recorder-resumed", severity="warning", episode_id=found.folder.name, by=note["by"],
            away_s=note["away_s"], restarts=taken.take.manifest.recorder.restarts, messages=note["kept_messages"],
        )  # fmt: skip
        return taken.written_ns


def _ended_before(recording: Recording, folder: Path, requests: list[str]) -> dict[str, Any]:
    """Have whoever ended an episode answered as its own recorder would have; returns the summary."""
    manifest = find_manifest(folder).manifest
    summary = summary_of(manifest)
    answer = RecordAnswer(id="", ok=True, episode_id=manifest.episode_id, path=str(folder), summary=summary)
    recording.ended_before(answer, requests)
    return summary


def _has_begun(folder: Path) -> bool:
    """Whether there is anything of an episode; of one that has not begun its start is still to be done."""
    return any((folder / name).exists() for name in (layout.MANIFEST, layout.ACTIVE, layout.SIGNALS))


def _forgotten(folder: Path) -> ResumePoint | None:
    """Remove the folder of an episode that has not begun; return where its start stands in the stream, if known."""
    point = load_resume_point(folder)
    (folder / layout.RESUME).unlink(missing_ok=True)
    remove_leftovers(folder / layout.MANIFEST, folder / layout.RESUME)
    with contextlib.suppress(OSError):  # somebody put something else there
        folder.rmdir()
    is_recent = point is not None and 0 <= time.monotonic_ns() - point.mono_ns < _PATIENCE_S * 1e9
    return point if is_recent and point is not None and point.anchor.boot == boot_id() else None
