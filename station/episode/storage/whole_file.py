"""A file that is there whole or not at all, written by one process at a time."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from station.atomic_file import sync_folder
from station.episode.storage.named_lock import open_locked, remove_unlocked
from station.errors import EpisodeError, StationError


class OutputRefused(OSError):
    """The system refused the file that is being written; every other `OSError` is of the code that writes it."""


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file to be written; it gets its name, in place of an older one, when the block ends without an error.

    What a killed process left is overwritten by the next.

    Raises:
        EpisodeError: another process is writing it.
        OutputRefused: the disk refused it.
    """
    part = part_of(path)
    claim: io.FileIO | None = None
    try:
        with _refusals():
            claim = _claimed(part)
            claim.truncate(0)
        with io.BufferedWriter(_Output(claim.fileno(), "ab", closefd=False)) as file:
            yield file
            file.flush()
        with _refusals():
            os.fsync(claim.fileno())
            os.replace(part, path)
            claim.close()
    except BaseException:
        if claim is not None:
            claim.close()
        remove_unlocked(part)  # an interrupt may come at any moment, also before we know that we have it
        raise
    with _refusals():
        sync_folder(path.parent)


def part_of(path: Path) -> Path:
    """Return where a file is while it is written."""
    return path.with_name(f".{path.name}.part")


@contextmanager
def named_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file that a person asked for by its name; as `whole_file`, and what fails is told with what to do.

    Raises:
        StationError: it cannot be written, or another process is writing it.
    """
    try:
        with whole_file(path) as file:
            yield file
    except OutputRefused as error:
        why = error.strerror or error
        raise StationError(f"{path}: cannot be written ({why}); name a file in a folder of yours") from error


class _Output(io.FileIO):
    """The file as the code that writes it has it."""

    def write(self, data: Any, /) -> int:
        with _refusals():
            return super().write(data)


def _claimed(part: Path) -> io.FileIO:
    """Open the file of that name and have it for this process, until it is closed."""
    try:
        return open_locked(part, waits=False)
    except BlockingIOError:
        raise EpisodeError(f"{part}: another process is writing this file; wait for it") from None


@contextmanager
def _refusals() -> Iterator[None]:
    """Mark what the system says within the block as said of our file."""
    try:
        yield
    except OSError as error:
        raise OutputRefused(error.errno, error.strerror, error.filename) from error
