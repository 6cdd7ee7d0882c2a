"""From the pictures of an episode to one video per camera, in one pass over its file, one picture at a time."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from adapters.exports.lerobot.av_library import DEPTH_PIXELS, PIXELS, Decoder, av
from adapters.exports.lerobot.depth_codes import codes_of
from adapters.exports.lerobot.plan import Camera, Plan
from adapters.exports.lerobot.stats import PixelCounts
from adapters.exports.lerobot.video import VideoWriter, expect_frames
from adapters.exports.row_pictures import RowPictures, feed_all
from station import depth
from station.contract import DEPTH_STEP_M
from station.episode.reading.messages import Ints
from station.episode.reading.reader import EpisodeReader
from station.errors import EpisodeError


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
        for camera in plan.common.pictures:
            film = (_Film if camera.step_m is None else _DepthFilm)(
                reader.episode_id, camera, plan, rows[camera.key], folder
            )
            unfinished.callback(film.abandon)
            films[camera.key] = film
        feed_all(reader, {key: film.rows for key, film in films.items()})
        found = {key: film.finish() for key, film in films.items()}
        unfinished.pop_all()
    return found


class _Film:
    codec: ClassVar[Literal["hevc"] | None] = None

    def __init__(self, episode: str, camera: Camera, plan: Plan, rows: Ints, folder: Path) -> None:
        self._what, self._camera, self._count = f"{episode}: camera {camera.name!r}", camera, len(rows)
        self._decoder, self._reformatter = Decoder(), av.video.reformatter.VideoReformatter()
        self._file = folder / f"{camera.column}.mp4"
        codec = self.codec or plan.codec
        self._video = VideoWriter(self._file, camera.height, camera.width, plan.fps, codec, plan.gop)
        self._samples = frozenset(PixelCounts.samples(len(rows)))
        self._pixels = PixelCounts() if self.codec is None else PixelCounts.of_depth()
        self.rows = RowPictures(self._what, rows, self._prepared, self._add)

    def finish(self) -> Encoded:
        self._video.close()
        shown = self.rows.finish()
        expect_frames(self._file, self._count, self._what)
        return Encoded(shown.numbers, self._pixels, shown.bad)

    def abandon(self) -> None:
        self._video.abandon()

    def _add(self, row: int, picture: Any) -> None:
        if row in self._samples:
            self._pixels.add(_rgb(picture))
        self._video.add(picture)

    def _prepared(self, jpeg: bytes) -> Any | None:
        """Return a picture as it is encoded: limited range, both sides even."""
        picture = self._decoder.picture(jpeg)
        if picture is None:
            return None
        camera = self._camera
        expect_size(self._what, picture, camera)
        return self._reformatter.reformat(
            picture, width=camera.width, height=camera.height, format=PIXELS,
            dst_colorspace=av.video.reformatter.Colorspace.ITU601,
            dst_color_range=av.video.reformatter.ColorRange.MPEG,
        )  # fmt: skip


class _DepthFilm(_Film):
    """Of depth: its codes as LeRobot has them, shape (height, width)."""

    codec = "hevc"

    def _add(self, row: int, picture: NDArray[np.uint16]) -> None:
        if row in self._samples:
            self._pixels.add(picture[:, :, None])
        self._video.add(av.VideoFrame.from_ndarray(picture, format=DEPTH_PIXELS))

    def _prepared(self, jpeg: bytes) -> NDArray[np.uint16] | None:
        known = depth.head(jpeg)
        if known is None:
            return None
        expect_size(self._what, known, self._camera)
        steps = depth.decoded(jpeg)
        return None if steps is None else codes_of(steps, self._camera.step_m or DEPTH_STEP_M)


def expect_size(what: str, picture: Any, camera: Camera) -> None:
    """Refuse a picture of another size than the data set has, for a camera of an episode, `what`.

    Raises:
        EpisodeError: it has; tells both sizes.
    """
    least = 1 if camera.step_m is not None else 2  # a video has even sides
    if (picture.height // least * least, picture.width // least * least) != (camera.height, camera.width):
        raise EpisodeError(
            f"{what}: a picture of {picture.width}x{picture.height} pixels, the data set has "
            f"{camera.width}x{camera.height}; export these episodes apart"
        )


def _rgb(picture: Any) -> NDArray[np.uint8]:
    found: NDArray[np.uint8] = picture.to_ndarray(format="rgb24")
    return found
