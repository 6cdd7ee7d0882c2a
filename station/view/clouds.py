"""Point clouds in Rerun: thinned to a point per cube, on the body that the lidar is mounted on."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np
import rerun as rr

from station import point_cloud
from station.bus import keys
from station.episode.reading import frames
from station.view import scene
from station.view.episode_curves import Source
from station.view.layout import TIMELINE

CLOUDS = "clouds"
_WORLD = "world"
_RADIUS_M = 0.01
_COLOUR = (255, 170, 60)
_EPISODE_PERIOD_S = 0.5  # between clouds of an episode that are drawn: ten a second would be 90 MB a minute


def stated(servers: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """Return the frame of each lidar that servers state, by its key; "" for one without a mount."""
    found = {}
    for facts in servers:
        name, mount = facts.get("lidar"), facts.get("mount")
        if isinstance(name, str) and facts.get("key") == keys.lidar_cloud(name):
            parent = mount.get("parent") if isinstance(mount, Mapping) else ""
            found[keys.lidar_cloud(name)] = parent if isinstance(parent, str) else ""
    return found


def apart(frames_of_lidars: Iterable[str], bodies: Collection[str]) -> bool:
    """Whether any lidar is in a frame that is not drawn, so that its clouds need a view of their own."""
    return any(frame != _WORLD and frame not in bodies for frame in frames_of_lidars)


def log_cloud(recording: rr.RecordingStream, key: str, value: bytes, bodies: Collection[str]) -> str:
    """Log a cloud; return its entity, "" for what is none.

    Args:
        recording: Where to.
        key: Its key.
        value: Its bytes.
        bodies: Of the robot that is drawn.
    """
    try:
        cloud = point_cloud.decoded(value)
    except point_cloud.BadCloud:
        return ""
    name = key.removeprefix(keys.lidar_cloud(""))
    below = scene.WORLD if cloud.frame == _WORLD else CLOUDS
    entity = f"{scene.ROBOT}/{cloud.frame}/{name}" if cloud.frame in bodies else f"{below}/{name}"
    points = point_cloud.voxels(point_cloud.xyz(cloud))
    recording.log(entity, rr.Points3D(points, radii=_RADIUS_M, colors=[_COLOUR]))
    return entity


def draw_clouds(recording: rr.RecordingStream, source: Source, bodies: Collection[str]) -> list[str]:
    """Send clouds of every lidar of an episode, two a second; return those entities that are not in the scene."""
    entities = dict[str, None]()
    for key in frames.lidars(source.reader).values():
        next_s = -np.inf
        for frame in frames.frames(source.reader, key):
            at_s = float(source.seconds(np.array(frame.captured_ns)))
            if at_s < next_s:
                continue
            recording.set_time(TIMELINE, duration=at_s)
            if entity := log_cloud(recording, key, frame.data, bodies):
                next_s = at_s + _EPISODE_PERIOD_S
                entities[entity] = None
    return [entity for entity in entities if entity.startswith(f"{CLOUDS}/")]
