"""A strip of small pictures of each camera, evenly spaced over an episode."""

from __future__ import annotations

import io
from typing import NamedTuple

from station.episode.reading import frames
from station.episode.reading.frames import Frame
from station.episode.reading.reader import EpisodeReader

PICTURES = 7
_WIDTH, _HEIGHT, _QUALITY = 220, 220, 72
_MOST_CAMERAS = 8
_MOST_PIXELS = 40_000_000  # of a picture that is opened; a camera has 2 to 12 million


class Thumbnail(NamedTuple):
    """A small picture: when it was taken, from the start of the episode [s], and its JPEG; None for what is none."""

    at_s: float
    jpeg: bytes | None


def strips(reader: EpisodeReader) -> dict[str, list[Thumbnail]]:
    """Return small pictures of each camera by its name; one picture of the episode is in memory at a time."""
    begin_ns = reader.start_ns
    counts: dict[str, int] = {}
    for stream in reader.streams():
        if not stream.channel.is_deletion:
            counts[stream.channel.topic] = counts.get(stream.channel.topic, 0) + stream.count
    found = {}
    for name, topic in list(frames.cameras(reader).items())[:_MOST_CAMERAS]:
        wanted = (
            {round((counts[topic] - 1) * n / max(PICTURES - 1, 1)) for n in range(PICTURES)}
            if topic in counts
            else set()
        )
        found[name] = [
            Thumbnail((frame.captured_ns - begin_ns) * 1e-9, _small(frame))
            for number, frame in enumerate(frames.frames(reader, topic))
            if number in wanted
        ]
    return found


def _small(frame: Frame) -> bytes | None:
    """Return a small JPEG of a picture, or None for bytes that are none."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(frame.jpeg), formats=("JPEG",)) as picture:
            if picture.width * picture.height > _MOST_PIXELS:
                return None
            picture.draft("RGB", (_WIDTH, _HEIGHT))
            small = picture.convert("RGB")
            small.thumbnail((_WIDTH, _HEIGHT))
            made = io.BytesIO()
            small.save(made, format="jpeg", quality=_QUALITY)
            return made.getvalue()
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):  # what Pillow says of broken bytes
        return None
