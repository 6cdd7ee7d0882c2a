"""A file by whose name processes take turns, and which whoever has it may rename or remove."""

from __future__ import annotations

import contextlib
import fcntl
import io
import os
from pathlib import Path


def open_locked(path: Path, *, waits: bool) -> io.FileIO:
    """Open and lock the file of a name; it is made if need be, and nothing in it is changed.

    The lock goes with the file, when it is closed or its process ends, however it ends.

    Args:
        path: The file.
        waits: Whether to wait while another process has it.

    Raises:
        BlockingIOError: another process has it, and we do not wait.
        OSError: it cannot be opened.
    """
    while True:
        file = io.FileIO(path, "ab")
        try:
            fcntl.flock(file, fcntl.LOCK_EX if waits else fcntl.LOCK_EX | fcntl.LOCK_NB)
            if is_named(path, file):
                return file
        except BaseException:
            file.close()
            raise
        file.close()  # its owner has renamed or removed it meanwhile: the next one is another file


def is_named(path: Path, file: io.FileIO | io.BufferedIOBase) -> bool:
    """Whether a name is still that of an open file."""
    try:
        return os.path.samestat(path.stat(), os.fstat(file.fileno()))
    except FileNotFoundError:
        return False


def remove_unlocked(path: Path) -> None:
    """Remove the file of a name unless a process has it locked; what cannot be removed is left."""
    with contextlib.suppress(OSError), io.FileIO(path, "rb+") as file:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if is_named(path, file):
            path.unlink()
