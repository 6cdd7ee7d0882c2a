from __future__ import annotations

import os
from pathlib import Path

import pytest

from station.episode.recorder.disk_space import FreeSpace, mount_point, nearest_folder


def test_a_folder_that_is_not_there_yet_is_looked_up_where_it_will_be_made(tmp_path: Path) -> None:
    missing = tmp_path / "a" / "b"
    assert nearest_folder(missing) == tmp_path
    assert mount_point(missing) == mount_point(tmp_path)
    assert os.path.ismount(mount_point(missing))
    space = FreeSpace(missing)
    assert (space.look.free_bytes or 0) > 0
    assert space.look.trouble == ""
    space.close()


def test_a_fresh_look_is_newer_than_the_last(tmp_path: Path) -> None:
    space = FreeSpace(tmp_path)
    seen = [space.look.number, space.fresh(30.0).number, space.fresh(30.0).number]
    assert seen == sorted(set(seen))
    space.close()


def test_what_the_system_says_of_a_bad_disk_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(_path: object) -> os.statvfs_result:
        raise OSError(116, "Stale file handle")

    monkeypatch.setattr(os, "statvfs", gone)
    space = FreeSpace(tmp_path)
    assert (space.look.free_bytes, space.look.trouble) == (None, "Stale file handle")
    space.close()
