"""Reads a server's log as it grows."""

from __future__ import annotations

import os
from pathlib import Path

_MOST_BYTES = 4 * 1024 * 1024


class LogTail:
    """Reads a log as it grows; one that was begun anew is read from its beginning.

    Args:
        path: The file; not necessarily there yet.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._inode, self._offset = 0, 0

    def read(self, *, is_last: bool = False) -> list[str]:
        """Return the lines that are new, a line that is not whole yet only where it is the last look."""
        try:
            with self._path.open("rb") as file:
                state = os.fstat(file.fileno())
                if state.st_ino != self._inode or state.st_size < self._offset:
                    self._inode, self._offset = state.st_ino, max(0, state.st_size - _MOST_BYTES)
                file.seek(self._offset)
                text = file.read(_MOST_BYTES)
        except FileNotFoundError:  # between one station and the next
            return []
        end = len(text) if is_last or len(text) == _MOST_BYTES else text.rfind(b"\n") + 1
        self._offset += end
        return text[:end].decode("utf-8", "replace").splitlines()
