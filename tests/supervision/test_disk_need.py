from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from servers.camera import CameraConfig
from servers.lidar import LidarConfig
from station.bus import keys
from station.episode.storage.manifest import (
    Compacted,
    Manifest,
    RecordedFile,
    Recorder,
    Stream,
    Task,
    Timing,
    save_manifest,
)
from station.supervision.disk_need import SIGNALS_MB_PER_MINUTE, disk_need

HEAD = CameraConfig(width=640, height=480, fps=30)


def record(
    data: Path, number: int, *, mb: float, seconds: float, cameras: tuple[str, ...] = ("head",), **more: Any
) -> str:
    """Put the manifest of an episode of the task walk into a data folder; return its id."""
    folder = data / "walk" / f"2026-11-21-g1-walk-{number:04d}"
    folder.mkdir(parents=True)
    streams = [Stream(key=keys.camera_image(name), file="cameras.mcap", count=9) for name in cameras]
    manifest = Manifest(
        episode_id=folder.name, task=Task(name="walk"), streams=[Stream(key="own", count=9), *streams],
        timing=Timing(duration_s=seconds), recorder=Recorder(bytes=round(mb * 1e6)), **{"state": "finished", **more},
    )  # fmt: skip
    save_manifest(manifest, folder)
    return folder.name


def test_without_cameras_and_episodes_it_is_that_of_signals(tmp_path: Path) -> None:
    assert disk_need({"g1": object()}, tmp_path, "walk") == (SIGNALS_MB_PER_MINUTE, "")


def test_every_camera_that_will_run_counts_by_its_size_and_rate(tmp_path: Path) -> None:
    one = disk_need({"g1": object(), "head": HEAD}, tmp_path, None)
    usb_mb_per_minute = (40e-3 * 30 * 60, 90e-3 * 30 * 60)  # measured: 40 to 90 kB a picture
    assert usb_mb_per_minute[0] < one.mb_per_minute - SIGNALS_MB_PER_MINUTE < usb_mb_per_minute[1]
    assert one.why == "1 camera, estimated"
    small = CameraConfig(width=320, height=240, fps=15)
    three = disk_need({"head": HEAD, "left": HEAD, "right": small}, tmp_path, None)
    pictures = (one.mb_per_minute - SIGNALS_MB_PER_MINUTE) * (1 + 1 + 1 / 8)
    assert three.mb_per_minute == pytest.approx(SIGNALS_MB_PER_MINUTE + pictures)
    assert three.why == "3 cameras, estimated"
    assert disk_need({"head": CameraConfig()}, tmp_path, None) == one, "a source's own is 640x480 at 30 Hz"


def test_a_lidar_counts_too(tmp_path: Path) -> None:
    one = disk_need({"head": HEAD}, tmp_path, None)
    both = disk_need({"head": HEAD, "top": LidarConfig()}, tmp_path, None)
    assert both.mb_per_minute - one.mb_per_minute == pytest.approx(5.2 * 60)
    assert both.why == "1 camera, 1 lidar, estimated"
    record(tmp_path, 1, mb=50, seconds=30)
    assert disk_need({"head": HEAD, "top": LidarConfig()}, tmp_path, "walk") == both, "that one had no lidar"


def test_the_last_episode_of_the_task_with_the_same_cameras_knows_better(tmp_path: Path) -> None:
    record(tmp_path, 1, mb=50, seconds=30)
    newest = record(tmp_path, 2, mb=40, seconds=30)
    record(tmp_path, 3, mb=9, seconds=30, cameras=())
    record(tmp_path, 4, mb=9, seconds=1)
    record(tmp_path, 5, mb=9, seconds=30, state="failed")
    assert disk_need({"head": HEAD}, tmp_path, "walk") == (80.0, f"as {newest}")
    named = {"camera-1": CameraConfig(name="head")}
    assert disk_need(named, tmp_path, "walk").mb_per_minute == 80.0
    with_depth = CameraConfig(source="mujoco", width=640, height=480, fps=30, depth=True)
    found = disk_need({"head": with_depth}, tmp_path, "walk")
    assert found.why == "1 camera, estimated", "that one had no depth"
    assert found.mb_per_minute > 4 * disk_need({"head": HEAD}, tmp_path, "jog").mb_per_minute, "noise of a sensor"
    assert disk_need({"left": HEAD}, tmp_path, "walk").why == "1 camera, estimated"
    assert disk_need({"head": HEAD}, tmp_path, "jog").why == "1 camera, estimated"
    assert disk_need({}, tmp_path, "walk").mb_per_minute == 18.0


def test_an_episode_that_was_compacted_since_tells_what_it_needed_when_it_was_recorded(tmp_path: Path) -> None:
    made_of = RecordedFile(name="cameras.mcap", bytes=30_000_000)
    note = Compacted(at="", software={}, encoder={}, cameras={}, made_of=made_of, bytes=2_000_000)
    record(tmp_path, 1, mb=12, seconds=30, compacted=note)
    assert disk_need({"head": HEAD}, tmp_path, "walk").mb_per_minute == 80.0
