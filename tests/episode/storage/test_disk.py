from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from station.episode.storage.disk import Disk, give_back, why_not
from station.errors import EpisodeError

ACTIVE = "signals.mcap.active"


def held_back(folder: Path) -> int:
    """Blocks of the room that is held back in a folder [bytes]."""
    return sum(file.stat().st_blocks * 512 for file in folder.iterdir() if file.name != ACTIVE)


def test_room_is_held_back_while_a_file_is_open_and_given_back_with_it(tmp_path: Path) -> None:
    disk = Disk(tmp_path / ACTIVE)
    assert held_back(tmp_path) >= 256 * 1024
    give_back(tmp_path)
    assert held_back(tmp_path) == 0
    disk.close()
    again = Disk(tmp_path / ACTIVE, keep=0)
    assert held_back(tmp_path) >= 256 * 1024
    again.close()
    assert [file.name for file in tmp_path.iterdir()] == [ACTIVE]


def replace(file: Path) -> None:
    file.unlink()
    file.write_bytes(b"")


@pytest.mark.parametrize("take_away", [Path.unlink, replace, lambda file: file.rename(file.with_name("x"))])
def test_a_file_that_is_no_longer_in_its_place_is_not_written_on(
    tmp_path: Path, take_away: Callable[[Path], object]
) -> None:
    disk = Disk(tmp_path / ACTIVE)
    disk.write(b"1")
    disk.flush()
    take_away(tmp_path / ACTIVE)
    disk.write(b"2")
    with pytest.raises(FileNotFoundError, match=ACTIVE):
        disk.flush()
    assert disk.written == 1
    disk.close()


def test_a_flush_that_fails_is_cut_off_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk, sound = Disk(tmp_path / ACTIVE), os.write
    disk.write(b"whole")
    disk.flush()
    disk.write(b"half")
    calls: list[int] = []

    def full(descriptor: int, data: bytes) -> int:
        calls.append(descriptor)
        if len(calls) > 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return sound(descriptor, data[:2])

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(OSError, match="No space left"):
        disk.flush()
    monkeypatch.undo()
    disk.close()
    assert (tmp_path / ACTIVE).read_bytes() == b"whole"


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.ENOSPC, "free the disk, then start a new episode"),
        (errno.EROFS, "make the disk writable, then start a new episode"),
        (errno.ENOENT, "unmounted while it was written: bring the folder back, then start a new episode"),
        (errno.ELOOP, "look after the disk, then start a new episode"),
    ],
)
def test_a_reason_says_what_to_do_whoever_met_the_error(tmp_path: Path, number: int, remedy: str) -> None:
    error = OSError(number, os.strerror(number))
    assert why_not(error, tmp_path) == f"{os.strerror(number)} ({tmp_path}); {remedy}".replace(
        "unmounted", "it was removed, renamed or unmounted"
    )
    wrapped = EpisodeError(f"manifest: {os.strerror(number)}")
    wrapped.__cause__ = error
    assert why_not(wrapped, tmp_path).endswith(remedy)
    assert why_not(EpisodeError("no episode"), tmp_path) == "no episode"
