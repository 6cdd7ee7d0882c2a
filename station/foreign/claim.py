"""One recording is taken in by one process at a time, whoever else was asked to."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

from station.episode.storage.named_lock import open_locked


@contextlib.contextmanager
def claimed(making: Path) -> Iterator[None]:
    """Claim the place of a folder that is to be made, waiting while another process has it.

    Nothing is there when it is claimed, nor afterwards: what a process made and did not rename is removed, also where
    it was killed. A file beside it, ``NAME.lock``, is there as long as it is claimed.

    Raises:
        OSError: nothing can be made there.
    """
    with contextlib.suppress(FileExistsError):  # a file stands there, and the lock cannot be made
        making.parent.mkdir(parents=True, exist_ok=True)
    lock = making.with_name(f"{making.name}.lock")
    with open_locked(lock, waits=True):
        try:
            shutil.rmtree(making, ignore_errors=True)  # of a process that was killed
            yield
        finally:
            shutil.rmtree(making, ignore_errors=True)
            lock.unlink(missing_ok=True)  # last: from now on others make theirs
