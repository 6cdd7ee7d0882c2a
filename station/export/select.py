"""Which episodes an export is of: named by id, path or pattern, or all of a data folder."""

from __future__ import annotations

import fnmatch
import glob
from collections.abc import Iterable, Sequence
from pathlib import Path

from station.episode.storage.folder import data_folder, find_episodes, resolve, slug
from station.episode.storage.manifest_copy import find_manifest
from station.errors import EpisodeError, UsageError
from station.export.kind import Source

_MAGIC = frozenset("*?[")


def sources(episodes: Sequence[str], data: Path | None = None, *, tasks: Sequence[str] = ()) -> list[Source]:
    """Return the episodes that are meant, each once, in the order in which they were named, else oldest first.

    Nothing is said here of what they are worth: an unfinished or torn one is told of when it is opened.

    Args:
        episodes: Paths, ids, unique beginnings of ids, ``latest``, or patterns (``*?[``) of paths or ids; none at all
            takes every episode of the data folder.
        data: The data folder; None takes ``$STATION_DATA``, else ``./data``.
        tasks: Of these, episodes of these tasks alone; none at all takes every task.

    Raises:
        EpisodeError: one is not found, or a task has none.
        UsageError: two of them have the same id.
    """
    base = data_folder(data)
    folders = [folder for name in episodes for folder in _named(name, base)] if episodes else find_episodes(base)
    if tasks:
        of_tasks = {task: {folder for folder in folders if _is_of(folder, task)} for task in dict.fromkeys(tasks)}
        for task, those in of_tasks.items():
            if not those:
                raise EpisodeError(_why_none(base, f" of task {task!r}"))
        folders = [folder for folder in folders if any(folder in those for those in of_tasks.values())]
    found: dict[str, Path] = {}
    for folder in (folder.absolute() for folder in folders):
        if found.setdefault(folder.name, folder).resolve() != folder.resolve():
            raise UsageError(
                f"two episodes are called {folder.name}: {found[folder.name]} and {folder}; rename the folder of one"
            )
    if not found:
        raise EpisodeError(_why_none(base))
    return [Source(episode_id=name, folder=str(folder)) for name, folder in found.items()]


def _named(name: str, base: Path) -> Iterable[Path]:
    if not _MAGIC & set(name) or Path(name).exists():
        path = resolve(name, base)
        return [path.parent if path.is_file() else path]
    if "/" in name:
        places = [Path(place) for place in sorted(glob.glob(name))]
        folders = [place.parent if place.is_file() else place for place in places]
    else:
        folders = [folder for folder in find_episodes(base) if fnmatch.fnmatchcase(folder.name, name)]
    if not folders:
        raise EpisodeError(f"no episode fits {name!r}; `station episodes list` shows those of {base}")
    return [resolve(folder, base) for folder in folders]


def _is_of(folder: Path, task: str) -> bool:
    """Whether an episode is of a task; the folder that it lies in rules most others out without reading them."""
    try:
        return folder.parent.name == slug(task) and find_manifest(folder).manifest.task.name == task
    except EpisodeError:  # told when it is opened
        return True


def _why_none(base: Path, which: str = "") -> str:
    return f"no episodes{which} in {base.absolute()}; record some, or name another folder with --data"
