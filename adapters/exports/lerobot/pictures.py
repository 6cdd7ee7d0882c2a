"""From the pictures of an episode to one video per camera, in one pass over its file, one picture at a time."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.exports.lerobot.av_library import PIXELS, Decoder, av
from adapters.exports.lerobot.plan import Camera, Plan
from adapters.exports.lerobot.stats import PixelCounts
from adapters.exports.lerobot.video import VideoWriter, expect_frames
from station.episode.reading.messages import Ints
from station.episode.reading.reader import EpisodeReader
from station.errors import EpisodeError

_MOST_BAD = 0.01  # of a camera's pictures; more is no transmission error but a fault of the camera


@dataclass(frozen=True)
class Encoded:
    """What was encoded of one camera.

    Attributes:
        shown: Which picture, in order of arrival, each row of the video shows, shape (n,).
        pixels: Counts of the sampled pixels.
        bad: Pictures that could not be decoded; the one before stands in their place.
    """

    shown: Ints
    pixels: PixelCounts
    bad: int


def encode(reader: EpisodeReader, plan: Plan, rows: Mapping[str, Ints], folder: Path) -> dict[str, Encoded]:
    """Encode the video ``<column>.mp4`` of every camera.

    Args:
        reader: The episode.
        plan: Of the data set.
        rows: For each camera's key, which picture in order of arrival every row shows, never descending.
        folder: Where the videos go.

    Raises:
        EpisodeError: a picture has another size than the data set, too many cannot be decoded, or a video has not as
            many pictures as there are rows; names the camera.
        OSError: the disk refuses.
    """
    films: dict[str, _Film] = {}
    with ExitStack() as unfinished:
        for camera in plan.common.cameras:
            film = _Film(reader.episode_id, camera, plan, rows[camera.key], folder)
            unfinished.callback(film.abandon)
            films[camera.key] = film
        for message in reader.messages(films.keys()):
            if not message.channel.is_deletion:
                films[message.topic].feed(message.data)
        found = {key: film.finish() for key, film in films.items()}
        unfinished.pop_all()
    return found


class _Film:
    def __init__(self, episode: str, camera: Camera, plan: Plan, rows: Ints, folder: Path) -> None:
        self._what, self._camera, self._rows = f"{episode}: camera {camera.name!r}", camera, rows
        self._decoder, self._reformatter = Decoder(), av.video.reformatter.VideoReformatter()
        self._file = folder / f"{camera.column}.mp4"
        self._video = VideoWriter(self._file, camera.height, camera.width, plan.fps, plan.codec, plan.gop)
        self._samples = frozenset(PixelCounts.samples(len(rows)))
        self._pixels = PixelCounts()
        self._shown: list[int] = []
        self._arrived = self._bad = 0
        self._last: tuple[int, Any] | None = None

    def feed(self, jpeg: bytes) -> None:
        """Add the next picture in order of arrival."""
        row, number = len(self._shown), self._arrived
        self._arrived += 1
        if row == len(self._rows) or self._rows[row] != number:
            return
        picture = self._prepared(jpeg)
        if picture is not None:
            self._last = number, picture
        else:
            self._bad += 1
        if self._last is None:
            raise EpisodeError(
                f"{self._what}: picture {number}, the first one of the rows, is no JPEG that can be read"
            )
        while row < len(self._rows) and self._rows[row] == number:
            self._add(row, *self._last)
            row += 1

    def finish(self) -> Encoded:
        self._video.close()
        if self._bad > max(1, _MOST_BAD * len(set(self._rows.tolist()))):
            raise EpisodeError(f"{self._what}: {self._bad} pictures are no JPEG files that can be read")
        expect_frames(self._file, len(self._rows), self._what)
        return Encoded(np.array(self._shown, dtype=np.int64), self._pixels, self._bad)

    def abandon(self) -> None:
        self._video.abandon()

    def _add(self, row: int, number: int, picture: Any) -> None:
        if row in self._samples:
            self._pixels.add(_rgb(picture))
        self._video.add(picture)
        self._shown.append(number)

    def _prepared(self, jpeg: bytes) -> Any | None:
        """Return a picture as it is encoded: limited range, both sides even."""
        picture = self._decoder.picture(jpeg)
        if picture is None:
            return None
        camera = self._camera
        if (picture.height // 2 * 2, picture.width // 2 * 2) != (camera.height, camera.width):
            raise EpisodeError(
                f"{self._what}: a picture of {picture.width}x{picture.height} pixels, the data set has "
                f"{camera.width}x{camera.height}; export these episodes apart"
            )
        return self._reformatter.reformat(
            picture, width=camera.width, height=camera.height, format=PIXELS,
            dst_colorspace=av.video.reformatter.Colorspace.ITU601,
            dst_color_range=av.video.reformatter.ColorRange.MPEG,
        )  # fmt: skip


def _rgb(picture: Any) -> NDArray[np.uint8]:
    found: NDArray[np.uint8] = picture.to_ndarray(format="rgb24")
    return found
