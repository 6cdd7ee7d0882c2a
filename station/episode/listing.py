"""Which episodes there are: one row each, from their manifests, without opening the signals."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec

from station.episode import layout
from station.episode.claim import is_claimed
from station.episode.folder import data_folder, find_episodes
from station.episode.manifest import Manifest, load_manifest
from station.episode.progress import load_resume_point
from station.errors import EpisodeError

RowState = Literal["finished", "recording", "unfinished", "failed", "broken"]


class EpisodeRow(msgspec.Struct, frozen=True, kw_only=True):
    """One episode in a list.

    Attributes:
        episode_id, path: Its id and folder.
        state: ``recording`` now; ``unfinished``: its recorder was killed; ``failed``: the disk refused; ``broken``: the
            manifest cannot be read.
        task, robot, operator, started: As in the manifest; "" where unknown.
        seconds: Length from start to stop; None while unknown.
        messages, lost, size_bytes: Messages, sequence numbers lost over all streams, and size of the signals.
        dropped: Writes that the recorder could not keep; not among the lost.
        success, falls, is_discarded: Quality flags.
        verdict: What the last check said, "" before one.
        problem: Why it is broken, "" otherwise.
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
    verdict: str = ""
    problem: str = ""


def list_episodes(data: Path | None = None, *, task: str | None = None) -> list[EpisodeRow]:
    """Return a row for each episode of a data folder, oldest first; of one task where one is named.

    A folder that does not exist holds no episodes. An episode whose manifest cannot be read has a row that says so.
    """
    base = data_folder(data)
    folders = find_episodes(base)
    active = [folder for folder in folders if (folder / layout.ACTIVE).exists()]
    live = active[-1] if active and is_claimed(base) else None
    rows = [_row(folder, is_live=folder == live) for folder in folders]
    return [row for row in rows if task is None or row.task == task]


def _row(folder: Path, *, is_live: bool) -> EpisodeRow:
    size = sum(file.stat().st_size for file in folder.glob("*.mcap*"))
    try:
        manifest = load_manifest(folder)
    except EpisodeError as error:
        return EpisodeRow(episode_id=folder.name, path=str(folder), state="broken", size_bytes=size, problem=str(error))
    flags, point = manifest.quality_flags, load_resume_point(folder)
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
        verdict=str(manifest.quality.get("verdict", "")),
    )


def _state(manifest: Manifest, folder: Path, *, is_live: bool) -> RowState:
    if is_live:
        return "recording"
    if manifest.state == "recording":
        return "finished" if (folder / layout.SIGNALS).exists() else "unfinished"
    return manifest.state
