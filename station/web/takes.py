"""Episodes as a page shows them: what has been recorded, its verdict, and a check where it has none yet.

One thread of its own looks at the folder; a check is the command that a person would type, in a process of its own that
stands back behind everything else, and what it finds stands in the manifest as usual.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

from station.clock import Clock
from station.episode.quality.findings import Quality
from station.episode.reading.listing import EpisodeRow, NewestEpisodes
from station.episode.storage.manifest_copy import find_manifest
from station.errors import EpisodeError, StationError
from station.printable import printable
from station.view import names

MOST = 200
"""Episodes that a page is told of, the newest."""

_LOOK_S = 3.0  # a folder of 5,000 episodes takes 45 ms
_HOUR_S = 3600.0
_TEXT = 300
_NICENESS = "10"  # where all cores are busy, a tenth of one: a check takes a minute then


class Takes:
    """Looks at a folder of episodes.

    Args:
        data: The folder.
        clock: Time where the station is.
        tell: Called, in this object's thread, when something has changed.
        is_judging: Whether what was recorded while this looks on is checked.
    """

    def __init__(self, data: Path, clock: Clock, tell: Callable[[], None], *, is_judging: bool) -> None:
        self._clock, self._tell, self._is_judging = clock, tell, is_judging
        self._newest, self._rows = NewestEpisodes(data, MOST), list[EpisodeRow]()
        self._began = datetime.now(UTC)
        self._tried: set[str] = set()
        self._sheets = threading.Lock()
        self._woken = threading.Event()
        self._is_closed = False
        self._running: set[subprocess.Popen[bytes]] = set()
        self._thread = clock.start(self._run, "takes")

    def listing(self) -> list[dict[str, Any]]:
        """Return the episodes, newest first, in plain values."""
        return [_plain(row) for row in reversed(self._rows)]

    def figures(self) -> dict[str, Any]:
        """Return how it goes: takes of the last hour that were kept, and the newest verdict."""
        now = datetime.now(UTC)
        kept = [row for row in self._rows if row.state == "finished" and not row.is_discarded]
        hour = [row for row in kept if _age_s(row, now) < _HOUR_S]
        return {"last_hour": len(hour), "last": next((row.verdict for row in reversed(kept) if row.verdict), "")}

    def recording(self) -> dict[str, Any]:
        """Return task and length [s] of what is being recorded, as its folder says; empty where nothing is."""
        now = datetime.now(UTC)
        for row in reversed(self._rows):
            if row.state == "recording":
                return {"task": printable(row.task, _TEXT), "duration_s": round(_age_s(row, now), 1)}
        return {}

    def detail(self, episode: str) -> dict[str, Any] | None:
        """Return what is known of an episode, in words; None for one that is not there."""
        row = self._row(episode)
        if row is None:
            return None
        try:
            manifest, _ = find_manifest(Path(row.path))
            quality = msgspec.convert(manifest.quality, Quality, strict=False) if manifest.quality else None
        except (EpisodeError, msgspec.ValidationError):
            quality = None
        reasons = [] if quality is None else [printable(str(reason.text), _TEXT) for reason in quality.reasons]
        return {**_plain(row), "reasons": reasons, "figures": _figures(row), "has_sheet": row.state == "finished"}

    def folder(self, episode: str) -> Path:
        """Return the folder of an episode.

        Raises:
            EpisodeError: there is none, or it is still being recorded, or nothing of it can be read.
        """
        row = self._row(episode)
        if row is None:
            raise EpisodeError("no such episode among the newest; it was moved, or deleted")
        if row.state == "recording":
            raise EpisodeError("it is still being recorded; it can be played once it is closed")
        if row.state == "broken":
            raise EpisodeError(f"it is broken: {row.problem}")
        return Path(row.path).absolute()

    def sheet(self, episode: str) -> bytes | None:
        """Return the contact sheet of an episode as PNG, drawn where there is none; None where that cannot be.

        Takes seconds; one at a time.
        """
        row = self._row(episode)
        if row is None or row.state != "finished":
            return None
        path = Path(row.path) / names.CONTACT_SHEET
        with self._sheets:
            if not path.is_file():
                self._station("view", row.path, "--contact-sheet")
            try:
                return path.read_bytes()
            except OSError:
                return None

    def wake(self) -> None:
        """Look at once: something has begun, or has ended."""
        self._woken.set()

    def close(self) -> None:
        """Look no more."""
        self._is_closed = True
        self._woken.set()
        for process in list(self._running):
            process.terminate()
        self._clock.join(self._thread)

    def _row(self, episode: str) -> EpisodeRow | None:
        return next((row for row in reversed(self._rows) if row.episode_id == episode), None)

    def _run(self) -> None:
        while not self._is_closed:
            self._woken.clear()
            try:
                rows = self._newest.look()
            except (OSError, StationError):  # it is being moved, or the disk is away; the next look tells
                rows = self._rows
            if rows != self._rows:
                self._rows = rows
                self._tell()
            if not self._judge():
                self._clock.wait(self._woken, _LOOK_S)

    def _judge(self) -> bool:
        """Check the oldest episode of our time that has no verdict yet; return whether there was one."""
        for row in self._rows if self._is_judging else ():
            is_ours = row.state == "finished" and not row.verdict and row.episode_id not in self._tried
            if is_ours and _started(row) >= self._began:
                self._tried.add(row.episode_id)
                self._station("check", row.path)
                return True
        return False

    def _station(self, *arguments: str) -> None:
        """Run a command of ours behind everything else; what it says stands in the manifest, or nowhere."""
        command = ["nice", "-n", _NICENESS, sys.executable, "-m", "station", *arguments]
        nothing = subprocess.DEVNULL
        with subprocess.Popen(command, stdin=nothing, stdout=nothing, stderr=nothing) as process:
            self._running.add(process)
            if self._is_closed:
                process.terminate()
            process.wait()
        self._running.discard(process)


def _plain(row: EpisodeRow) -> dict[str, Any]:
    return {
        "id": printable(row.episode_id, _TEXT), "task": printable(row.task, _TEXT), "path": printable(row.path, _TEXT),
        "started": printable(row.started, 40), "duration_s": row.seconds, "state": row.state,
        "verdict": "discarded" if row.is_discarded else row.verdict if row.state == "finished" else row.state,
        "success": row.success, "falls": row.falls, "lost": row.lost + row.dropped,
    }  # fmt: skip


def _figures(row: EpisodeRow) -> list[tuple[str, str]]:
    found = [
        ("length", "" if row.seconds is None else f"{row.seconds:.1f} s"),
        ("messages", f"{row.messages}"),
        ("lost", f"{row.lost}"),
        ("dropped", f"{row.dropped}"),
        ("falls", f"{row.falls}"),
        ("size", f"{row.size_bytes / 1e6:.1f} MB"),
        ("robot", row.robot),
        ("operator", row.operator),
        ("success", {None: "not said", True: "yes", False: "no"}[row.success]),
        ("problem", row.problem or row.changed),
    ]
    return [(name, printable(value, _TEXT)) for name, value in found if value]


def _started(row: EpisodeRow) -> datetime:
    try:
        return datetime.fromisoformat(row.started).astimezone()
    except (ValueError, OverflowError):
        return datetime.min.replace(tzinfo=UTC)


def _age_s(row: EpisodeRow, now: datetime) -> float:
    return max(0.0, (now - _started(row)).total_seconds())
