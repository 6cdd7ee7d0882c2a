"""The bin of a data folder: what was thrown away waits there, whole, until somebody takes it back or empties it.

``DATA/.bin/<task>/<episode_id>``: laid out as the data folder, on its disk, so a way in or out is one rename. Nothing
that looks for episodes looks there, and no new episode gets the id of one that lies there.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from pathlib import Path

from station.atomic_file import sync_folder
from station.episode.storage import layout
from station.episode.storage.claim import is_claimed
from station.episode.storage.folder import BIN
from station.episode.storage.left_open import is_left_open
from station.errors import EpisodeError, did_you_mean
from station.lock_file import is_locked

_DELETING = ".deleting"
_FILES = tuple(name for names in layout.ALL_NAMES for name in (names.final, names.active, names.repairing))


def bin_folder(data: Path) -> Path:
    """Return the bin of a data folder; perhaps not there."""
    return data / BIN


def in_bin(data: Path) -> list[Path]:
    """Return the folders that lie in the bin, by id."""
    found = (folder for folder in bin_folder(data).glob("*/*/") if not folder.parent.name.startswith("."))
    return sorted(found, key=lambda folder: folder.name)


def expect_at_rest(folder: Path, data: Path) -> None:
    """Refuse an episode that somebody writes, or may go on with.

    Raises:
        EpisodeError: it is being recorded or repaired, or was left open while a recorder is at work.
    """
    if any(is_locked(folder / name) for name in _FILES):
        raise EpisodeError(f"{folder.name}: is being written just now; wait until the recording is stopped")
    if is_claimed(data) and is_left_open(folder):
        raise EpisodeError(f"{folder.name}: a recorder may still go on with it; stop the recorder, or repair it first")


def throw_away(folder: Path, data: Path) -> Path:
    """Move an episode into the bin; return where it lies.

    Raises:
        EpisodeError: it is not at rest, or the bin has one of its id, or the disk refused it.
    """
    expect_at_rest(folder, data)
    return move(folder, bin_folder(data) / folder.parent.name, data)


def find_in_bin(episode: str, data: Path) -> Path:
    """Return the folder of an episode in the bin by its id or the beginning of one.

    Raises:
        EpisodeError: there is none, or several.
    """
    folders = in_bin(data)
    found = [folder for folder in folders if folder.name == episode] or [
        folder for folder in folders if folder.name.startswith(episode)
    ]
    if len(found) == 1:
        return found[0]
    if found:
        raise EpisodeError(f"episode {episode!r}: {len(found)} in the bin of {data} fit; write more of the id")
    known = [folder.name for folder in folders]
    raise EpisodeError(
        f"episode {episode!r}: not in the bin of {data.absolute()}, which holds {len(known)}"
        f"{did_you_mean(episode, known)}; `station episodes list --bin` shows them"
    )


def take_back(folder: Path, data: Path) -> Path:
    """Move an episode from the bin to where it was; return where it is.

    Raises:
        EpisodeError: one of its id is there, or the disk refused it.
    """
    return move(folder, data / folder.parent.name, data)


def delete(folder: Path, data: Path) -> None:
    """Delete an episode that lies in the bin; killed on the way, it is never half there again.

    Raises:
        EpisodeError: the disk refused it.
    """
    doomed = bin_folder(data) / _DELETING
    try:
        doomed.mkdir(parents=True, exist_ok=True)
        if (doomed / folder.name).exists():  # of one that was killed
            shutil.rmtree(doomed / folder.name)
        folder.rename(doomed / folder.name)
        shutil.rmtree(doomed / folder.name)
    except OSError as error:
        raise EpisodeError(f"{folder}: cannot be deleted: {error.strerror} ({error.filename})") from error


def clear(data: Path) -> None:
    """Remove what is left of the bin when all that lay in it is deleted; something of others stays."""
    shutil.rmtree(bin_folder(data) / _DELETING, ignore_errors=True)
    for folder in (*bin_folder(data).glob("*/"), bin_folder(data)):
        with contextlib.suppress(OSError):
            folder.rmdir()


def size_of(folder: Path) -> int:
    """Return the size of all files of an episode, those that were made of it and those that were torn too [bytes]."""
    return sum(entry.stat().st_size for entry in folder.rglob("*") if entry.is_file() and not entry.is_symlink())


def move(folder: Path, parent: Path, data: Path) -> Path:
    """Move an episode into another folder of its data folder, by one rename; return where it is then.

    Raises:
        EpisodeError: one of its id is there, or the disk refused it.
    """
    target = parent / folder.name
    if os.path.lexists(target):
        raise EpisodeError(f"{target}: is there already; move one of the two away")
    try:
        parent.mkdir(parents=True, exist_ok=True)
        folder.rename(target)
        for changed in (folder.parent, parent):
            sync_folder(changed)
    except OSError as error:
        raise EpisodeError(f"{folder}: cannot be moved to {target}: {error.strerror}") from error
    if not is_claimed(data):  # its recorder may be about to make an episode in the folder of the task
        with contextlib.suppress(OSError):  # others are in it
            folder.parent.rmdir()
    return target
