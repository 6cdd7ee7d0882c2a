"""A file that is there whole or not at all, written by one process at a time."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from station.episode.storage.atomic import sync_folder
from station.errors import EpisodeError, StationError


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file to be written; it gets its name, in place of an older one, when the block ends without an error.

    What a killed process left is overwritten by the next.

    Raises:
        EpisodeError: another process is writing it.
        OSError: the disk refused it.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        with _claim(part) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
            os.replace(part, path)
    except BaseException:
        _remove(part)
        raise
    sync_folder(path.parent)


@contextmanager
def named_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file that a person asked for by its name; as `whole_file`, and what fails is told with what to do.

    Raises:
        StationError: it cannot be written, or another process is writing it.
    """
    try:
        with whole_file(path) as file:
            yield file
    except OSError as error:
        why = error.strerror or error
        raise StationError(f"{path}: cannot be written ({why}); name a file in a folder of yours") from error


def _claim(part: Path) -> BinaryIO:
    """Open and lock an empty file of that name; the lock goes with the process that holds it."""
    while True:
        file = part.open("ab")  # that truncates nothing: somebody else may be writing it
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_named(part, file):
                file.truncate(0)
                return file
        except BlockingIOError:
            file.close()
            raise EpisodeError(f"{part}: another process is writing this file; wait for it") from None
        except BaseException:
            file.close()
            raise
        file.close()  # its last writer finished in between: the file has its final name, or is gone


def _remove(part: Path) -> None:
    """Remove what was begun, unless somebody else has begun it anew."""
    with contextlib.suppress(OSError), part.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if _is_named(part, file):
            part.unlink()


def _is_named(part: Path, file: BinaryIO) -> bool:
    return part.exists() and os.path.samestat(part.stat(), os.fstat(file.fileno()))
