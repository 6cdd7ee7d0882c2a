"""The file under an MCAP writer: everything of a flush in one write, nothing in between."""

from __future__ import annotations

import contextlib
import fcntl
import os
from pathlib import Path

from station.episode.atomic import write_all
from station.errors import EpisodeError


class Disk:
    """The output of the MCAP library: collects, and writes everything in one call when flushed.

    So a failing disk shows in `flush` only, and a process killed between two flushes leaves whole chunks.
    """

    def __init__(self, path: Path, *, keep: int | None = None) -> None:
        """Create the file; or, with `keep`, open the one that is there and cut off what lies behind that byte.

        Raises:
            OSError: the disk refused it, or the file exists (does not exist).
        """
        self.path = path
        flags = os.O_CREAT | os.O_EXCL if keep is None else 0
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CLOEXEC | flags, 0o644)
        with contextlib.suppress(OSError):  # where a file system knows no locks, the claim of the folder must do
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._parts: list[bytes] = []
        self._position = self.written = keep or 0
        if keep is not None:
            os.ftruncate(self._descriptor, keep)
            os.lseek(self._descriptor, keep, os.SEEK_SET)

    def write(self, data: bytes) -> int:
        """Keep bytes until the next flush."""
        if data:
            self._parts.append(data)
            self._position += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the position that the next byte will have."""
        return self._position

    def flush(self) -> None:
        """Hand everything to the system.

        Raises:
            OSError: the disk is full or gone; what of this flush was written is cut off again where possible.
        """
        data = b"".join(self._parts)
        self._parts.clear()
        try:
            write_all(self._descriptor, data)
        except OSError:
            os.ftruncate(self._descriptor, self.written)
            raise
        self.written += len(data)

    def sync(self) -> None:
        """Wait until the data are on the disk."""
        os.fdatasync(self._descriptor)

    def close(self) -> None:
        """Release the file; what was not flushed is lost."""
        os.close(self._descriptor)


def is_being_written(path: Path) -> bool:
    """Whether a living process has a file open as its `Disk`; the kernel knows, whatever became of the process."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(descriptor)
    return False


def why_not(error: OSError | EpisodeError, folder: Path) -> str:
    """Say in a line why an episode cannot be written, and what to do."""
    if isinstance(error, OSError):
        return f"{error.strerror or error} ({error.filename or folder}); free the disk, then start a new episode"
    return str(error)
