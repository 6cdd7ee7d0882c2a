"""Depth pictures in Rerun: beside their time line as pictures, and as points where the camera's place is drawn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import rerun as rr

from station.episode.reading import frames
from station.view.episode_curves import Source
from station.view.layout import TIMELINE

DEPTH = "depth"


def draw_depth(recording: rr.RecordingStream, source: Source, placed: Mapping[str, str]) -> list[str]:
    """Send the depth of every camera, picture by picture, and return its entities.

    Args:
        recording: Where to.
        source: The episode.
        placed: Entity of each camera that is drawn in the scene, by its name: what lies below becomes points in space.
    """
    entities = []
    for camera, topic in frames.depths(source.reader).items():
        below = placed.get(camera, "")
        entities.append(f"{below}/{DEPTH}" if below else f"{DEPTH}/{camera}")
        meter = 1.0 / frames.step_m(source.reader, topic)
        for frame in frames.frames(source.reader, topic):
            recording.set_time(TIMELINE, duration=float(source.seconds(np.array(frame.captured_ns))))
            picture = rr.EncodedDepthImage(blob=frame.data, media_type=rr.components.MediaType.PNG, meter=meter)
            recording.log(entities[-1], picture)
    return entities
