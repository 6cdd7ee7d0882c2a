"""Who waits for a file by its name gets the one that has the name, not the one that had it."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from station.episode.storage.named_lock import is_named, open_locked
from tests.waiting import wait_until


def removed(path: Path) -> None:
    path.unlink()


def renamed(path: Path) -> None:
    path.rename(path.with_name("final"))


def replaced(path: Path) -> None:
    path.unlink()
    path.write_bytes(b"another")


@pytest.mark.parametrize("leave", [removed, renamed, replaced])
def test_who_waited_has_the_file_that_is_called_so_now(tmp_path: Path, leave: Callable[[Path], None]) -> None:
    path, found = tmp_path / "lock", []

    def wait() -> None:
        with open_locked(path, waits=True) as file:
            found.append(is_named(path, file))

    with open_locked(path, waits=False) as first:
        other = threading.Thread(target=wait)
        other.start()
        wait_until(lambda: is_waited_for(path))
        leave(path)
        assert not is_named(path, first)
        assert found == []
    other.join()
    assert found == [True]


def test_who_does_not_wait_is_told_and_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "lock"
    path.write_bytes(b"half")
    with open_locked(path, waits=False), pytest.raises(BlockingIOError):
        open_locked(path, waits=False)
    assert path.read_bytes() == b"half"


def is_waited_for(path: Path) -> bool:
    """Whether a file that is locked has been opened once more in this process."""
    opened = 0
    for link in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed while we looked
            opened += os.readlink(link) == str(path)
    return opened == 2
