"""h5py, or one line that says how to get it."""

from __future__ import annotations

import importlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from station.errors import StationError


def _load() -> Any:
    try:
        return importlib.import_module("h5py")
    except ImportError as error:
        raise StationError(
            f"HDF5 files need h5py ({error}); install it with `pip install 'teleop-station[hdf5]'`"
        ) from error


h5py: Any = _load()  # has no types of its own


_RESERVE = 8 << 20  # bytes


@contextmanager
def create(file: Path) -> Iterator[Any]:
    """Create a file and close it.

    What cannot be written as a file is closed ends the process: the library keeps its memory, and frees it twice. So
    room for that is kept until then.

    Raises:
        OSError: the disk refuses.
    """
    reserve = file.with_name(f".{file.name}.reserve")
    try:
        with reserve.open("xb") as room:
            os.posix_fallocate(room.fileno(), 0, _RESERVE)
        opened = h5py.File(file, "x", rdcc_nbytes=0)  # no chunk waits in memory: each is written whole, and once
        try:
            yield opened
        finally:
            reserve.unlink()
            opened.close()
    except OSError as error:  # the library's own text is a paragraph
        if error.errno is None:
            raise
        raise OSError(error.errno, os.strerror(error.errno), error.filename or str(file)) from error
    finally:
        reserve.unlink(missing_ok=True)
