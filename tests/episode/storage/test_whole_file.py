"""A large file is there whole or not at all, and what a person named is told of in one line."""

from __future__ import annotations

import fcntl
import io
import os
import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from station.episode.storage import whole_file as module
from station.episode.storage.whole_file import named_file, whole_file
from station.errors import EpisodeError, StationError

OURS = str(Path(str(module.__file__)).parent)


@contextmanager
def at_most(size: int) -> Iterator[None]:
    """Have the system refuse larger files of this process [bytes]."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def write(path: Path, data: bytes = b"new", *, fails: Exception | None = None) -> None:
    with named_file(path) as file:
        file.write(data)
        if fails is not None:
            raise fails


def test_it_takes_the_place_of_an_older_one_and_leaves_nothing_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_bytes(b"an older one")
    (tmp_path / ".report.html.part").write_bytes(b"what a killed process left, which is longer")
    write(path)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == {"report.html": b"new"}


class Interrupted:
    """Raises `KeyboardInterrupt` before one of the lines that our own code executes within a block.

    Attributes:
        lines: How many were executed.
    """

    def __init__(self, before_line: int) -> None:
        self.lines, self._before = 0, before_line

    def __enter__(self) -> Interrupted:
        sys.settrace(self._see)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(None)

    def _see(self, frame: FrameType, event: str, _: object) -> Any:
        if not frame.f_code.co_filename.startswith(OURS):
            return None
        if event == "line":
            self.lines += 1
            if self.lines == self._before:
                raise KeyboardInterrupt
        return self._see


@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # of who is interrupted as it opens one
def test_an_interrupt_at_any_moment_leaves_the_older_one_or_the_new_one_and_nothing_beside_it(tmp_path: Path) -> None:
    path, line, left, is_interrupted = tmp_path / "report.html", 0, set(), True
    while is_interrupted:
        path.write_bytes(b"an older one")
        line, is_interrupted = line + 1, False
        try:
            with Interrupted(before_line=line) as trial, whole_file(path) as file:
                file.write(b"new")
        except KeyboardInterrupt:
            is_interrupted = True
        left.add(path.read_bytes())
        assert [found.name for found in tmp_path.iterdir()] == [path.name], f"before line {line}"
    assert trial.lines == line - 1 > 20
    assert left == {b"an older one", b"new"}


def test_what_fails_half_way_leaves_the_older_one(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_bytes(b"an older one")
    with pytest.raises(ZeroDivisionError):
        write(path, fails=ZeroDivisionError())
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == {"report.html": b"an older one"}


@pytest.mark.parametrize("size", [io.DEFAULT_BUFFER_SIZE // 2, io.DEFAULT_BUFFER_SIZE * 2])
def test_a_disk_that_refuses_half_way_is_told_and_leaves_the_older_one(tmp_path: Path, size: int) -> None:
    path = tmp_path / "report.html"
    path.write_bytes(b"an older one")
    with (
        at_most(100),
        pytest.raises(StationError, match=r"report\.html: cannot be written \(File too large\); name a file"),
    ):
        write(path, b"new" * size)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == {"report.html": b"an older one"}


def test_what_the_system_says_of_another_file_is_not_told_of_this_one(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as raised:
        write(tmp_path / "report.html", fails=FileNotFoundError(2, "No such file or directory", "style.css"))
    assert raised.value.filename == "style.css"
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_takes_no_file_is_told_with_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(StationError, match=r"folder: cannot be written \(Is a directory\); name a file in a folder"):
        write(tmp_path / "folder")
    with pytest.raises(StationError, match=r"none/r: cannot be written \(No such file or directory\); name a file"):
        write(tmp_path / "none" / "r")
    assert [file.name for file in tmp_path.iterdir()] == ["folder"]


def test_one_that_another_process_writes_is_refused(tmp_path: Path) -> None:
    part = tmp_path / ".report.html.part"
    with part.open("wb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(EpisodeError, match=r"\.part: another process is writing this file; wait for it"):
            write(tmp_path / "report.html")
    assert part.exists()


def test_all_of_it_is_on_the_disk_before_the_older_one_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, safe = tmp_path / "cameras.mcap", [0]
    path.write_bytes(b"old")
    fsync, replace = os.fsync, os.replace

    def synced(descriptor: int) -> None:
        fsync(descriptor)
        safe[0] = os.fstat(descriptor).st_size

    def replaced(part: Path, name: Path) -> None:
        assert (safe[0], path.read_bytes()) == (100_000, b"old")
        replace(part, name)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", replaced)
    write(path, bytes(100_000))
    assert path.stat().st_size == 100_000
