"""A strip of small pictures of each camera: what it saw at some moments of an episode; depth in colours."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from station import depth
from station.episode.reading import frames
from station.episode.reading.frames import Frame
from station.episode.reading.reader import EpisodeReader
from station.protocols import Floats

if TYPE_CHECKING:
    from PIL.Image import Image

_QUALITY = 72
_SPREAD = (2, 98)  # percentiles of the depths of a picture that are told apart
_MOST_CAMERAS = 8
_MOST_PIXELS = 40_000_000  # of a picture that is opened; a camera has 2 to 12 million


class Thumbnail(NamedTuple):
    """A small picture: when it was taken, from the start of the episode [s], and its JPEG; None for what is none."""

    at_s: float
    jpeg: bytes | None


def evenly(reader: EpisodeReader, count: int) -> Floats:
    """Return instants from the first to the last picture of an episode's cameras [s], shape (count,)."""
    topics = set(frames.all_pictures(reader).values())
    ends = [(stream.first_ns, stream.last_ns) for stream in reader.streams()
            if stream.count and stream.channel.topic in topics]  # fmt: skip
    if not ends:
        return np.empty(0)
    first_ns, last_ns = min(first for first, _ in ends), max(last for _, last in ends)
    return np.linspace((first_ns - reader.start_ns) * 1e-9, (last_ns - reader.start_ns) * 1e-9, count)


def strips(reader: EpisodeReader, at_s: Sequence[float] | Floats, width: int) -> dict[str, list[Thumbnail | None]]:
    """Return what each camera saw by its name: the newest picture at each instant, None before its first one.

    Two pictures of the episode are in memory at a time.

    Args:
        reader: The episode.
        at_s: Instants in order, from the start of the episode [s].
        width: Of the pictures, which are no higher [px]; those of a camera that is smaller stay as they are.
    """
    depths = set(frames.depths(reader).values())
    wanted_ns = [reader.start_ns + round(each * 1e9) for each in at_s]
    return {
        name: _strip(reader, topic, wanted_ns, partial(_small_depth if topic in depths else _small, width=width))
        for name, topic in list(frames.all_pictures(reader).items())[:_MOST_CAMERAS]
    }


def _strip(
    reader: EpisodeReader, topic: str, wanted_ns: Sequence[int], small: Callable[[Frame], bytes | None]
) -> list[Thumbnail | None]:
    strip: list[Thumbnail | None] = []
    newest: Frame | None = None

    def show_newest_before(end_ns: float) -> None:
        count = sum(at_ns < end_ns for at_ns in wanted_ns[len(strip) :])
        if count and newest is not None:
            strip.extend([Thumbnail((newest.captured_ns - reader.start_ns) * 1e-9, small(newest))] * count)
        else:
            strip.extend([None] * count)

    for frame in frames.frames(reader, topic):
        show_newest_before(frame.captured_ns)
        newest = frame
    show_newest_before(math.inf)
    return strip


def _small(frame: Frame, width: int) -> bytes | None:
    """Return a small JPEG of a picture, or None for bytes that are none."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(frame.data), formats=("JPEG",)) as picture:
            if picture.width * picture.height > _MOST_PIXELS:
                return None
            picture.draft("RGB", (width, width))
            return _jpeg(picture.convert("RGB"), width)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):  # what Pillow says of broken bytes
        return None


def _small_depth(frame: Frame, width: int) -> bytes | None:
    """Return a small JPEG of depth: yellow for its nearest 2 %, blue for its farthest, black where there is none."""
    from matplotlib import colormaps
    from PIL import Image

    steps = depth.decoded(frame.data)
    if steps is None:
        return None
    seen = steps > 0
    near, far = np.percentile(steps[seen], _SPREAD) if seen.any() else (0.0, 1.0)
    colours = colormaps["viridis_r"]((steps - near) / max(far - near, 1.0), bytes=True)[:, :, :3]
    colours[~seen] = 0
    return _jpeg(Image.fromarray(colours), width)


def _jpeg(picture: Image, width: int) -> bytes:
    picture.thumbnail((width, width))
    made = io.BytesIO()
    picture.save(made, format="jpeg", quality=_QUALITY)
    return made.getvalue()
