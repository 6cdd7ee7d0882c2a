"""``station episodes compact`` as a user types it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from station import depth
from tests.cli.test_tidy import station
from tests.episode.compacting.test_compact import jpeg, record
from tests.episode.depth_scenes import DEPTH, steps
from tests.episode.filming import Scene, film
from tests.faults.disks import small_disk


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One with pictures, one whose pictures are noise, one without any."""
    monkeypatch.setenv("STATION_DATA", str(tmp_path))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    record(tmp_path, [jpeg(number) for number in range(60)], number=1)
    record(tmp_path, [jpeg(number, grain=60.0) for number in range(3)], number=2)
    shots = Scene()
    film(tmp_path / "walk" / name(3), [shots.signals(2)], shots.anchor)
    return tmp_path


def name(number: int) -> str:
    return f"2026-11-21-g1-walk-{number:04d}"


def video(data: Path, number: int) -> bool:
    return b"foxglove.CompressedVideo" in (data / "walk" / name(number) / "cameras.mcap").read_bytes()


def test_one_line_per_episode_says_what_became_of_it_and_a_second_call_finds_nothing_left(data: Path) -> None:
    done = station("compact", "--all", "--yes", "--jobs", "1", "--crf", "36")
    assert done.exit_code == 0, done.output
    first, second, third, total = done.stdout.splitlines()
    assert first.startswith(f"{name(1)} 0.1 MB to 0.0 MB (")
    assert "times smaller), 60 pictures, PSNR" in first
    assert second.startswith(f"{name(2)} left as it is: camera_image_head: PSNR ")
    assert second.endswith("a lower --crf than 36 keeps more")
    assert third == f"{name(3)} no pictures in it"
    assert total == "1 episode compacted, 0.1 MB to 0.0 MB; 1 left as they are"
    assert [video(data, number) for number in (1, 2)] == [True, False]
    again = station("compact", name(1), "--yes")
    assert (again.exit_code, again.stdout.split(",")[0]) == (0, f"{name(1)} compacted already")


def test_depth_that_stays_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STATION_DATA", str(tmp_path))
    shots, pictures = Scene(), []
    for number in range(60):
        colour = shots.picture(data=jpeg(number))
        pictures += [colour, colour._replace(key=DEPTH, value=depth.encoded(steps(number, width=8, height=60)))]
    film(tmp_path / "walk" / name(1), [pictures], shots.anchor)
    for options in (("--dry-run",), ("--yes",), ("--yes",)):
        done = station("compact", name(1), *options)
        assert (done.exit_code, done.stdout.strip().endswith(f"; depth stays as it is: {DEPTH}")) == (0, True)


def test_a_dry_run_and_a_missing_yes_change_nothing(data: Path) -> None:
    dry = station("compact", "--task", "walk", "--dry-run")
    assert dry.exit_code == 0
    assert dry.stdout.splitlines()[0] == f"{name(1)} 0.1 MB of pictures"
    asked = station("compact", name(1))
    assert asked.exit_code == 2
    assert "--yes makes the pictures of 1 episode, 0.1 MB, H.264 for good" in asked.output
    assert station("compact").exit_code == 2
    assert not video(data, 1)


@pytest.mark.usefixtures("processes")
def test_a_disk_that_fills_up_costs_nothing_and_is_named(data: Path) -> None:
    (data / "disk").mkdir()
    source = record(
        data / "source", [jpeg(number, width=320, height=240, grain=60.0) for number in range(10)], number=7
    )
    with small_disk(data / "disk", 1) as disk:
        folder = disk.path / "walk" / source.name
        shutil.copytree(source, folder)
        done = station("compact", "--all", "--yes", "--crf", "3", "--jobs", "1", "--data", str(disk.path))
        assert done.exit_code == 1
        assert f"{folder}: the disk: No space left on device; make room, run it again" in done.output
        assert (folder / "cameras.mcap").read_bytes() == (source / "cameras.mcap").read_bytes()
        assert sorted(file.name for file in folder.iterdir()) == ["cameras.mcap", "manifest.yaml", "signals.mcap"]


def test_one_that_is_damaged_is_told_and_the_rest_is_done(data: Path) -> None:
    cameras = data / "walk" / name(2) / "cameras.mcap"
    cameras.write_bytes(cameras.read_bytes()[:-50])
    done = station("compact", name(2), name(1), "--yes", "--jobs", "1", "--json")
    assert done.exit_code == 1
    assert f"first: station episodes repair {name(2)}" in done.output
    (found,) = json.loads(done.stdout)
    assert (found["episode_id"], found["state"], found["pictures"]) == (name(1), "compacted", 60)
    assert found["bytes_after"] < found["bytes_before"]
