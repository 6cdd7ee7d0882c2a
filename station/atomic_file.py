"""Small files, and whole folders, that are either the old or the new one after a crash, never half of each."""

from __future__ import annotations

import ctypes
import errno
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # linux/fcntl.h, linux/fs.h


def write_atomic(
    path: Path,
    data: bytes,
    *,
    sync: bool = True,
    mode: int = 0o644,
    put: Callable[[str, Path], None] | None = None,
) -> None:
    """Replace a file: temporary file beside it, fsync, rename, fsync of the folder.

    Without `sync` the file survives the death of the process, not that of the machine. By default it is read by anyone
    who may enter the folder, as an episode is.

    Args:
        path: The file.
        data: All that it holds.
        sync: Whether to wait for the disk.
        mode: Its permissions.
        put: Renames the temporary file, or raises what is to be raised here; by default `os.replace`.

    Raises:
        OSError: the disk refused it; the old file is then untouched.
    """
    descriptor, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        try:
            write_all(descriptor, data)
            os.fchmod(descriptor, mode)  # mkstemp closes it to others
            if sync:
                os.fsync(descriptor)
        finally:
            os.close(descriptor)
        (put or os.replace)(temporary, path)
    except BaseException:  # an interrupt too
        Path(temporary).unlink(missing_ok=True)
        raise
    if sync:
        sync_folder(path.parent)


def refuse_special(path: Path) -> None:
    """Refuse a path that is there and no regular file: opening a pipe waits for its writer.

    Raises:
        OSError: it is none.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "no regular file", str(path))


def remove_leftovers(*paths: Path) -> None:
    """Remove the temporary files that a process left which was killed in `write_atomic`."""
    for path in paths:
        for leftover in path.parent.glob(f".{path.name}.*"):
            leftover.unlink(missing_ok=True)


def exchange(one: Path, other: Path) -> None:
    """Exchange the names of two files or folders in one step: at no instant either name is missing.

    Raises:
        OSError: the system or the file system cannot do that (``EINVAL``, ``ENOSYS``), or refuses; nothing has changed.
    """
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)  # Python has no name for it
    code = errno.ENOSYS
    if rename is not None:
        names = (_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other))
        code = ctypes.get_errno() if rename(*names, _RENAME_EXCHANGE) else 0
    if code:
        raise OSError(code, os.strerror(code), str(other))


def free_path(path: Path) -> Path:
    """Return a path that does not exist: the given one, or with a number behind it."""
    number, free = 1, path
    while free.exists():
        number += 1
        free = path.with_name(f"{path.name}.{number}")
    return free


def write_all(descriptor: int, data: bytes) -> None:
    """Write every byte; one call of the system may take fewer."""
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(descriptor, rest) :]


def sync_folder(folder: Path) -> None:
    """Make renames and new files in a folder survive a power loss."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
