"""The file under an MCAP writer: everything of a flush in one write, nothing in between."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from pathlib import Path

from station.atomic_file import write_all
from station.episode.storage import layout
from station.errors import EpisodeError

_BALLAST = f".{layout.MANIFEST}.ballast"  # so named, it goes with the manifest's leftovers when a recorder was killed
_BALLAST_BYTES = 256 * 1024  # that of a demo has 30 kB, and 500 events, the most it lists, are 100 more

_REMEDIES = {
    errno.ENOSPC: "free the disk",
    errno.EDQUOT: "free some of your quota",
    errno.ENOENT: "it was removed, renamed or unmounted while it was written: bring the folder back",
    errno.ENOTDIR: "it was removed, renamed or unmounted while it was written: bring the folder back",
    errno.ESTALE: "it was removed, renamed or unmounted while it was written: bring the folder back",
    errno.EROFS: "make the disk writable",
    errno.EACCES: "make the folder writable",
    errno.EIO: "look after the disk",
}


class Disk:
    """The output of the MCAP library: collects, and writes everything in one call when flushed.

    So a failing disk shows in `flush` only, and a process killed between two flushes leaves whole chunks. Beside the
    file some room is held back until it is closed, in which a manifest can say that the disk is full.
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
        self._is_synced = False
        if keep is not None:
            os.ftruncate(self._descriptor, keep)
            os.lseek(self._descriptor, keep, os.SEEK_SET)
        self._identity = _identity(os.fstat(self._descriptor))
        _hold_back(path.parent)

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
            OSError: the disk is full, or the file no longer stands where it was made and would vanish once closed; what
                of this flush was written is cut off again where possible.
        """
        data = b"".join(self._parts)
        self._parts.clear()
        if _identity(os.stat(self.path)) != self._identity:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self.path))
        try:
            write_all(self._descriptor, data)
        except OSError:
            with contextlib.suppress(OSError):  # a torn chunk at the end is cut by its reader
                os.ftruncate(self._descriptor, self.written)
            raise
        self.written += len(data)
        self._is_synced &= not data

    def sync(self) -> None:
        """Wait until the data are on the disk; at once where nothing has come since the last time.

        Raises:
            OSError: the disk refused it.
        """
        if not self._is_synced:
            os.fdatasync(self._descriptor)
            self._is_synced = True

    def close(self) -> None:
        """Release the file; what was not flushed is lost."""
        with contextlib.suppress(OSError):  # a bad disk has said so when it was synced
            os.close(self._descriptor)
        give_back(self.path.parent)


def _identity(status: os.stat_result) -> tuple[int, int]:
    return status.st_dev, status.st_ino


def _hold_back(folder: Path) -> None:
    """Occupy some room on the disk, as a file."""
    with contextlib.suppress(OSError):  # where there is none, the next flush says so
        descriptor = os.open(folder / _BALLAST, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            os.posix_fallocate(descriptor, 0, _BALLAST_BYTES)
        finally:
            os.close(descriptor)


def give_back(folder: Path) -> None:
    """Free the room that was held back for the last words of an episode."""
    with contextlib.suppress(OSError):  # it went with its folder, or its disk cannot be written
        (folder / _BALLAST).unlink(missing_ok=True)


def why_not(error: OSError | EpisodeError, folder: Path) -> str:
    """Return in a line why an episode cannot be written, and what to do."""
    cause = error.__cause__ if isinstance(error, EpisodeError) else error
    remedy = _REMEDIES.get(cause.errno or 0, "look after the disk") if isinstance(cause, OSError) else ""
    what = f"{error.strerror or error} ({error.filename or folder})" if isinstance(error, OSError) else str(error)
    return f"{what}; {remedy}, then start a new episode" if remedy else what
