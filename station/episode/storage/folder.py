"""Where episodes live: ``DATA/<task>/<episode_id>``; how a new one gets its number and an old one is found."""

from __future__ import annotations

import contextlib
import os
import re
import time
import unicodedata
from pathlib import Path

from station.episode.storage import layout
from station.episode.storage.records import metadata_at_head
from station.errors import EpisodeError, did_you_mean
from station.user_config import user_config

DATA_VARIABLE = "STATION_DATA"
LATEST = "latest"
BIN = ".bin"
"""Folder of a data folder that holds what was thrown away, laid out as the data folder is."""

_NUMBERED = re.compile(r"\d{4}-\d\d-\d\d-.*-(\d+)")
_LONGEST_SLUG = 48
_LONGEST_TIME = 19  # digits of nanoseconds since 1970
_SHOWN = 5


def data_folder(data: Path | None = None) -> Path:
    """Return the data folder: what was given, else ``$STATION_DATA``, else the user's default, else ``./data``."""
    named = data or os.environ.get(DATA_VARIABLE)
    return Path(named) if named else user_config().data or Path("data")


def slug(text: str) -> str:
    """Return text as part of a file name: letters of any script, digits, single dashes; never empty, never a path."""
    words = re.sub(r"[\W_]+", "-", unicodedata.normalize("NFKC", text).lower())
    return words.strip("-")[:_LONGEST_SLUG].strip("-") or "untitled"


def new_folder(data: Path, task: str, robot: str) -> Path:
    """Make the folder of a new episode, with the next free number of its task; its name is the episode's id.

    Making the folder is what claims the number, so two recorders never get the same.

    Args:
        data: The data folder; made when missing.
        task: Name of the task.
        robot: What the robot is called in the name, "" when none has been heard of.

    Raises:
        EpisodeError: the folder cannot be made.
    """
    parent = data / slug(task)
    start = f"{time.strftime('%Y-%m-%d')}-{slug(robot or 'robot')}-{slug(task)}"
    try:
        parent.mkdir(parents=True, exist_ok=True)
        known = {entry.name for place in (parent, data / BIN / parent.name) for entry in _folders(place)}
        number = 1 + max(map(_number, known), default=0)
        while True:
            folder = parent / f"{start}-{number:04d}"
            with contextlib.suppress(FileExistsError):
                if not _is_taken(data, folder.name):
                    folder.mkdir()
                    return folder
            number += 1
    except OSError as error:
        raise EpisodeError(
            f"data folder {data}: cannot make an episode in it: {error.strerror}; name another with --data"
        ) from error


def _is_taken(data: Path, episode_id: str) -> bool:
    """Whether an episode has an id, wherever it is now: one that got another task, or lies in the bin, keeps it."""
    tasks = [entry.path for base in (data, data / BIN) for entry in _folders(base)]
    return any(os.path.lexists(os.path.join(task, episode_id)) for task in tasks)


def find_episodes(data: Path | None = None) -> list[Path]:
    """Return the folders of all episodes of a data folder, oldest first."""
    base = data_folder(data)
    found = [folder for folder in base.glob("*/*/") if folder.parent.name[0] != "." and is_episode(folder)]
    return sorted(found, key=lambda folder: (started_ns(folder), folder.name))


def folders_of_tasks(data: Path) -> list[Path]:
    """Return the folders in the folders of all tasks, episodes or not; opens no file."""
    return [Path(entry.path) for task in tasks(data) for entry in _folders(data / task)]


def newest_ids(data: Path | None, beginning: str, most: int) -> list[str]:
    """Return ids with some beginning, the newest first by the day that they name; opens no file."""
    names = {entry.name for task in tasks(data) for entry in _folders(data_folder(data) / task)}
    return sorted((name for name in names if _NUMBERED.fullmatch(name) and name.startswith(beginning)), reverse=True)[
        :most
    ]


def tasks(data: Path | None = None) -> list[str]:
    """Return the names of the folders of a data folder, sorted; the bin is none."""
    return sorted(entry.name for entry in _folders(data_folder(data)) if not entry.name.startswith("."))


def _folders(folder: Path) -> list[os.DirEntry[str]]:
    """Return the folders in a folder; none where it cannot be read."""
    try:
        with os.scandir(folder) as entries:
            return [entry for entry in entries if entry.is_dir()]
    except OSError:
        return []


def resolve(episode: str | Path, data: Path | None = None) -> Path:
    """Return the folder (or file) of an episode named by path, id, ``task/id``, beginning of an id, or ``latest``.

    Raises:
        EpisodeError: not found, or ambiguous; says what comes close.
    """
    path = Path(episode)
    is_there = os.path.exists(path)  # pathlib's raises for a name that is too long for any file
    if is_there and (path.is_file() or (path.is_dir() and is_episode(path))):
        return path
    base, name = data_folder(data), str(episode)
    episodes = find_episodes(base)
    if name == LATEST and episodes:
        return episodes[-1]
    exact = [folder for folder in episodes if name in (folder.name, f"{folder.parent.name}/{folder.name}")]
    found = exact or [folder for folder in episodes if folder.name.startswith(name)]
    if len(found) == 1:
        return found[0]
    if found:
        listed = ", ".join(folder.name for folder in found[:_SHOWN]) + (", …" if len(found) > _SHOWN else "")
        raise EpisodeError(f"episode {name!r}: {len(found)} episodes in {base} fit: {listed}; write more of the id")
    if is_there and path.is_dir():
        raise EpisodeError(f"{path}: no episode: expected {layout.SIGNALS} or {layout.ACTIVE} in it")
    known = [folder.name for folder in episodes]
    cure = "`station episodes list` shows them" if known else "record one"
    raise EpisodeError(
        f"episode {name!r}: not found in {base.absolute()}, which holds {len(known)} episodes"
        f"{did_you_mean(name, known)}; {cure}, or name another folder with --data or ${DATA_VARIABLE}"
    )


def signals_file(episode: Path) -> Path:
    """Return the MCAP file of an episode's folder, finished or not; a file is returned as it is.

    Raises:
        EpisodeError: the folder has none.
    """
    if episode.is_file():
        return episode
    for name in (layout.SIGNALS, layout.ACTIVE):
        if (episode / name).is_file():
            return episode / name
    raise EpisodeError(f"{episode}: no signals in it: expected {layout.SIGNALS} or {layout.ACTIVE}")


def is_episode(folder: Path) -> bool:
    """Whether a folder holds an episode, or begins to."""
    return any((folder / name).is_file() for name in (layout.MANIFEST, layout.SIGNALS, layout.ACTIVE))


def is_numbered(folder: Path) -> bool:
    """Whether a folder is called as `new_folder` calls one."""
    return _NUMBERED.fullmatch(folder.name) is not None


def _number(name: str) -> int:
    match = _NUMBERED.fullmatch(name)
    return int(match.group(1)) if match else 0


def started_ns(folder: Path) -> int:
    """Return when an episode was started [ns since the epoch]: by its own clock, else by the age of its file."""
    for name in (layout.SIGNALS, layout.ACTIVE, layout.MANIFEST):
        file = folder / name
        if file.is_file():
            wall_ns = metadata_at_head(file, layout.ANCHOR_RECORD).get("wall_ns", "")
            is_time = wall_ns.isdecimal() and len(wall_ns) <= _LONGEST_TIME
            return int(wall_ns) if is_time else file.stat().st_mtime_ns
    return 0
