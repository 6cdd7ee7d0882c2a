"""A camera's pictures as pixels, or its depth in steps, into an array of a file, row by row, one picture in memory."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.exports.lerobot.av_library import Decoder, av
from adapters.exports.lerobot.pictures import expect_size
from adapters.exports.lerobot.plan import Camera
from adapters.exports.row_pictures import RowPictures
from station import depth
from station.episode.reading.messages import Ints


class RowPixels:
    """An array of RGB pictures, shape (n, height, width, 3), filled as pictures arrive; of depth as `shape` says.

    Args:
        array: Takes a picture by row.
        camera: Name and size, and whether it is depth.
        what: Episode and camera, for messages.
        numbers: Which picture in order of arrival each row shows, shape (n,).

    Attributes:
        rows: What is fed with pictures.
    """

    def __init__(self, array: Any, camera: Camera, what: str, numbers: Ints) -> None:
        self._array, self._camera, self._what = array, camera, what
        self._decoder, self._reformatter = Decoder(), av.video.reformatter.VideoReformatter()
        read = self._read if camera.step_m is None else self._read_depth
        self.rows = RowPictures(what, numbers, read, self._show)

    def _read(self, jpeg: bytes) -> NDArray[np.uint8] | None:
        picture = self._decoder.picture(jpeg)
        if picture is None:
            return None
        camera = self._camera
        expect_size(self._what, picture, camera)
        rgb = self._reformatter.reformat(picture, width=camera.width, height=camera.height, format="rgb24")
        found: NDArray[np.uint8] = rgb.to_ndarray()
        return found

    def _read_depth(self, data: bytes) -> depth.Steps | None:
        known = depth.head(data)
        if known is None:
            return None
        expect_size(self._what, known, self._camera)
        return depth.decoded(data)

    def _show(self, row: int, picture: NDArray[np.uint8] | depth.Steps) -> None:
        self._array[row] = picture.reshape(self._array.shape[1:])


def about_depth(camera: Camera) -> dict[str, Any]:
    """Return what the attributes of an array of depth say: what a number is in metres, and that 0 is none."""
    return {"unit": "m", "step": camera.step_m, "no_depth": 0}
