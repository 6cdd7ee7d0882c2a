"""Which episodes there are: one row each, from their manifests, without opening the signals."""

from __future__ import annotations

from collections.abc import Collection
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal

import msgspec

from station import config
from station.episode.storage import layout
from station.episode.storage.claim import is_claimed
from station.episode.storage.file_hashes import changes, glance, words
from station.episode.storage.folder import data_folder, find_episodes, folders_of_tasks, is_episode, started_ns
from station.episode.storage.manifest import Manifest
from station.episode.storage.manifest_copy import find_manifest
from station.episode.storage.manifest_parts import RecordedFile
from station.episode.storage.progress import load_resume_point
from station.errors import ConfigError, EpisodeError

UNCHECKED = "unchecked"
_BETTER = {"usable": ("usable", "good"), "good": ("good",)}
_DAY_S = 86400.0
_NEVER = datetime.min.replace(tzinfo=UTC)

RowState = Literal["finished", "recording", "unfinished", "failed", "broken"]


class EpisodeRow(msgspec.Struct, frozen=True, kw_only=True):
    """One episode in a list.

    Attributes:
        episode_id, path: Its id and folder.
        state: ``recording`` now; ``unfinished``: its recorder was killed; ``failed``: the disk refused; ``broken``: no
            manifest can be read.
        task, robot, operator, started: As in the manifest; "" where unknown.
        seconds: Length from start to stop; None while unknown.
        messages, lost, size_bytes: Messages, sequence numbers lost over all streams, and size of its files.
        dropped: Writes that the recorder could not keep; not among the lost.
        success, falls, is_discarded: Quality flags.
        tags: What people put on it.
        verdict: What the last check said, "" before one.
        changed: Which of its files are not those that were closed, or that were judged, by size and summary; "" for
            none. A verdict of other files is none.
        problem: Why its manifest cannot be read, also where the copy inside the signals can be; "" otherwise.
    """

    episode_id: str
    path: str
    state: RowState
    task: str = ""
    robot: str = ""
    operator: str = ""
    started: str = ""
    seconds: float | None = None
    messages: int = 0
    lost: int = 0
    dropped: int = 0
    size_bytes: int = 0
    success: bool | None = None
    falls: int = 0
    is_discarded: bool = False
    tags: list[str] = []
    verdict: str = ""
    changed: str = ""
    problem: str = ""


class EpisodeFilter(msgspec.Struct, frozen=True, kw_only=True):
    """Which episodes are wanted; what is left out asks for nothing.

    Attributes:
        task, operator: Name of the task, of the operator.
        verdicts: Any of these: ``good``, ``usable``, ``reject``, or ``unchecked`` before a check.
        least: This verdict or a better one, and not discarded since.
        success: What the operator said: ``yes``, ``no``, or ``unknown`` where nobody did.
        since, before: Started then or later; before then, and not at an unknown time.
        tags: All of these.
        is_discarded: Whether it was discarded.
    """

    task: str | None = None
    operator: str | None = None
    verdicts: Collection[str] = ()
    least: Literal["good", "usable"] | None = None
    success: Literal["yes", "no", "unknown"] | None = None
    since: datetime | None = None
    before: datetime | None = None
    tags: Collection[str] = ()
    is_discarded: bool | None = None

    def fits(self, row: EpisodeRow) -> bool:
        """Whether a row is one of them."""
        return (
            self.task in (None, row.task)
            and self.operator in (None, row.operator)
            and (not self.verdicts or (row.verdict or UNCHECKED) in self.verdicts)
            and (self.least is None or (row.verdict in _BETTER[self.least] and not row.is_discarded))
            and self.success in (None, {None: "unknown", True: "yes", False: "no"}[row.success])
            and (self.since is None or _started(row) >= self.since)
            and (self.before is None or _NEVER < _started(row) < self.before)
            and set(self.tags) <= set(row.tags)
            and self.is_discarded in (None, row.is_discarded)
        )


def since(text: str, now: datetime | None = None, *, where: str = "--since") -> datetime:
    """Return the instant that is meant by ``2h``, ``3d`` (ago), ``2026-11-20`` or ``2026-11-20T14:00`` (local time).

    Raises:
        ConfigError: none of these; `where` names the option.
    """
    try:
        if text.endswith("d") and text[:-1].strip():
            return (now or datetime.now(UTC)) - timedelta(seconds=float(text[:-1]) * _DAY_S)
        if text[:1].isdigit() and "-" in text:
            return datetime.fromisoformat(text).astimezone()
        return (now or datetime.now(UTC)) - timedelta(seconds=config.seconds(text, where=where))
    except (ValueError, OverflowError, ConfigError):
        raise ConfigError(f"{where}: expected 2h, 3d, 2026-11-20 or 2026-11-20T14:00, got {text!r}") from None


def list_episodes(
    data: Path | None = None, *, task: str | None = None, wanted: EpisodeFilter | None = None
) -> list[EpisodeRow]:
    """Return a row for each episode of a data folder that is wanted, oldest first; of one task where one is named.

    A folder that does not exist holds no episodes. Where a manifest cannot be read, its row says so, and is filled from
    the copy inside the signals where there is one.
    """
    base = data_folder(data)
    folders = find_episodes(base)
    active = [folder for folder in folders if (folder / layout.ACTIVE).exists()]
    live = active[-1] if active and is_claimed(base) else None
    rows = [_row(folder, is_live=folder == live) for folder in folders]
    return [row for row in rows if task in (None, row.task) and (wanted is None or wanted.fits(row))]


class NewestEpisodes:
    """The newest episodes of a data folder, for whoever looks again and again: only what has changed is read anew.

    Args:
        data: The folder; it need not be there.
        most: Episodes of which there are rows.
    """

    def __init__(self, data: Path, most: int) -> None:
        self._data, self._most = data, most
        self._started_ns: dict[Path, int] = {}
        self._rows: dict[Path, tuple[tuple[int, ...], EpisodeRow]] = {}

    def look(self) -> list[EpisodeRow]:
        """Return a row for each, oldest first.

        Raises:
            OSError: a folder goes away meanwhile, or cannot be read.
        """
        there = folders_of_tasks(self._data)
        known = {folder: self._started_ns[folder] for folder in there if folder in self._started_ns}
        self._started_ns = known | {
            folder: started_ns(folder) for folder in there if folder not in known and is_episode(folder)
        }
        newest = sorted(self._started_ns, key=lambda folder: (self._started_ns[folder], folder.name))[-self._most :]
        active = [folder for folder in newest if (folder / layout.ACTIVE).exists()]
        live = active[-1] if active and is_claimed(self._data) else None
        rows = {}
        for folder in newest:
            seen, known_row = _seen(folder, is_live=folder == live), self._rows.get(folder)
            is_same = known_row is not None and known_row[0] == seen
            rows[folder] = known_row if known_row and is_same else (seen, _row(folder, is_live=folder == live))
        self._rows = rows
        return [row for _, row in rows.values()]


def _seen(folder: Path, *, is_live: bool) -> tuple[int, ...]:
    """Return what changes where the row of an episode does: times of its folder and its manifest, and who has it."""
    manifest = folder / layout.MANIFEST
    at_ns = manifest.stat().st_mtime_ns if manifest.exists() else 0
    return folder.stat().st_mtime_ns, at_ns, int(is_live)


def _started(row: EpisodeRow) -> datetime:
    """Return when an episode was started; long ago where nothing says."""
    try:
        return datetime.fromisoformat(row.started).astimezone()
    except (ValueError, OverflowError):
        return _NEVER


def _row(folder: Path, *, is_live: bool) -> EpisodeRow:
    files = (file for names in layout.ALL_NAMES for file in folder.glob(names.final + "*"))
    size = sum(file.stat().st_size for file in files)
    try:
        manifest, problem = find_manifest(folder)
    except EpisodeError as error:
        return EpisodeRow(episode_id=folder.name, path=str(folder), state="broken", size_bytes=size, problem=str(error))
    flags, point, changed = manifest.quality_flags, load_resume_point(folder), _changed(manifest, folder)
    return EpisodeRow(
        episode_id=manifest.episode_id or folder.name,
        path=str(folder),
        state=_state(manifest, folder, is_live=is_live),
        task=manifest.task.name,
        robot=manifest.robot.suffix,
        operator=manifest.operator.id,
        started=manifest.timing.started,
        seconds=manifest.timing.duration_s,
        messages=manifest.recorder.messages or (point.messages if point else 0),
        lost=sum(stream.lost for stream in manifest.streams),
        dropped=manifest.recorder.dropped,
        size_bytes=size,
        success=flags.success,
        falls=flags.falls,
        is_discarded=flags.discarded,
        tags=manifest.tags,
        verdict="" if changed else str(manifest.quality.get("verdict", "")),
        changed=changed,
        problem=problem,
    )


def _changed(manifest: Manifest, folder: Path) -> str:
    """Return in a line which files are not those that were closed, or not those that a check measured."""
    try:
        judged = msgspec.convert(manifest.quality.get("files", []), list[RecordedFile])
    except msgspec.ValidationError:
        judged = []
    if not manifest.files and not judged:
        return ""
    try:
        found = glance(folder)
    except OSError as error:
        return f"{error.filename or folder}: cannot be read: {error.strerror}"
    return words(changes(manifest.files, found) or changes(judged, found))


def _state(manifest: Manifest, folder: Path, *, is_live: bool) -> RowState:
    if is_live:
        return "recording"
    if manifest.state == "recording":
        return "finished" if (folder / layout.SIGNALS).exists() else "unfinished"
    return manifest.state
