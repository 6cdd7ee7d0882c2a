"""What an episode will need of the disk: measured on the last one of its task, else by what will run."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

from station.bus import keys
from station.episode.storage import layout, pictures
from station.episode.storage.folder import find_episodes, slug
from station.episode.storage.manifest import Manifest
from station.episode.storage.manifest_copy import find_manifest
from station.errors import EpisodeError

SIGNALS_MB_PER_MINUTE = 8.0
"""Of a simulated humanoid without cameras, measured: 7.6."""

_MOST_LOOKED_AT = 5  # of the newest episodes of a task
_LEAST_S = 5.0  # a shorter one says little of a rate


@runtime_checkable
class Filming(Protocol):
    """The configuration of a server that publishes pictures."""

    def picture_bytes_per_s(self) -> float:
        """Return about how much the pictures need [bytes/s]."""
        ...


@runtime_checkable
class Scanning(Protocol):
    """The configuration of a server that publishes point clouds."""

    def cloud_bytes_per_s(self) -> float:
        """Return about how much the clouds need [bytes/s]."""
        ...


class DiskNeed(NamedTuple):
    """What an episode needs [MB/min], and how that is known; "" where only signals are expected."""

    mb_per_minute: float
    why: str


def disk_need(configs: dict[str, object], data: Path, task: str | None) -> DiskNeed:
    """Return what an episode will need.

    Args:
        configs: Configuration of each server that will run, by its name.
        data: Folder of episodes.
        task: Its task; None where that is not known yet.
    """
    cameras = {
        str(getattr(config, "name", "") or name): config.picture_bytes_per_s()
        for name, config in configs.items()
        if isinstance(config, Filming)
    }
    depths = {
        f"{getattr(config, 'name', '') or name}{pictures.DEPTH_ENDING}"
        for name, config in configs.items()
        if isinstance(config, Filming) and getattr(config, "depth", False)
    }
    lidars = {
        str(getattr(config, "name", "") or name): config.cloud_bytes_per_s()
        for name, config in configs.items()
        if isinstance(config, Scanning)
    }
    for manifest in _newest(data, task) if task else ():
        if (found := _measured(manifest, {*cameras, *depths}, lidars)) is not None:
            return DiskNeed(found, f"as {manifest.episode_id}")
    sensed = (sum(cameras.values()) + sum(lidars.values())) * 60e-6
    counts = [_counted(len(cameras), "camera"), _counted(len(lidars), "lidar")]
    why = ", ".join([*filter(None, counts), "estimated"]) if any(counts) else ""
    return DiskNeed(SIGNALS_MB_PER_MINUTE + sensed, why)


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'s' if count > 1 else ''}" if count else ""


def _newest(data: Path, task: str) -> Sequence[Manifest]:
    """Return manifests of the newest episodes of a task, the newest first; what cannot be read is left out."""
    folders = [folder for folder in find_episodes(data) if folder.parent.name == slug(task)]
    found = []
    for folder in folders[: -_MOST_LOOKED_AT - 1 : -1]:
        try:
            found.append(find_manifest(folder).manifest)
        except EpisodeError:
            continue
    return found


def _measured(manifest: Manifest, cameras: Collection[str], lidars: Collection[str]) -> float | None:
    """Return what an episode needed [MB/min]; None of one that was short, or had other cameras, depth, or lidars."""
    filmed = {
        pictures.title_of(stream.key) for stream in manifest.streams if stream.file == layout.CAMERAS and stream.count
    }
    scanned = {
        stream.key.removeprefix(keys.lidar_cloud(""))
        for stream in manifest.streams
        if stream.file == layout.CLOUDS and stream.count
    }
    seconds = manifest.timing.duration_s or 0.0
    is_alike = filmed == {*cameras} and scanned == {*lidars}
    if manifest.state != "finished" or seconds < _LEAST_S or not is_alike or not manifest.recorder.bytes:
        return None
    compacted = manifest.compacted
    saved = 0 if compacted is None else compacted.made_of.bytes - compacted.bytes
    return (manifest.recorder.bytes + saved) / (seconds + manifest.timing.preroll_s) * 60e-6
