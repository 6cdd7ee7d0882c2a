"""One recording is taken in by one process at a time, whoever else was asked to."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def claimed(making: Path) -> Iterator[None]:
    """Claim the place of a folder that is to be made, waiting while another process has it.

    Nothing is there when it is claimed, nor afterwards: what a process made and did not rename is removed, also where
    it was killed. A file beside it, ``NAME.lock``, is there as long as it is claimed.

    Raises:
        OSError: nothing can be made there.
    """
    lock = making.with_name(f"{making.name}.lock")
    descriptor = _locked(lock)
    try:
        shutil.rmtree(making, ignore_errors=True)  # of a process that was killed
        yield
    finally:
        shutil.rmtree(making, ignore_errors=True)
        lock.unlink(missing_ok=True)  # last: from now on others make theirs
        os.close(descriptor)


def _locked(lock: Path) -> int:
    """Return the descriptor of a locked file; the kernel lets go of it when this process ends, however it ends."""
    while True:
        try:
            descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except FileNotFoundError:
            lock.parent.mkdir(parents=True, exist_ok=True)
            continue
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            if _is_still(lock, descriptor):
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)


def _is_still(lock: Path, descriptor: int) -> bool:
    """Whether a name is still that of the file we hold, and was not removed while we waited for it."""
    try:
        return os.path.samestat(os.fstat(descriptor), lock.stat())
    except FileNotFoundError:
        return False
