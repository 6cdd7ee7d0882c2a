"""From pixels to a JPEG file, by simplejpeg."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from station.camera.source import CameraError

Bytes = NDArray[np.uint8]

_STUDIO_LUMA, _STUDIO_CHROMA = 219.0 / 255.0, 224.0 / 255.0


class Encoder:
    """Makes JPEG files of one quality.

    Args:
        quality: 1 to 100.

    Raises:
        CameraError: simplejpeg is not installed.
    """

    def __init__(self, quality: int) -> None:
        self.quality = quality
        self._library = library("simplejpeg", "simplejpeg", "a camera whose pictures are encoded here")

    def rgb(self, pixels: Bytes) -> bytes:
        """Return the file of a picture, shape (height, width, 3)."""
        contiguous = np.ascontiguousarray(pixels)
        data: bytes = self._library.encode_jpeg(contiguous, quality=self.quality, colorsubsampling="420")
        return data

    def yuyv(self, data: bytes, width: int, height: int, stride: int, *, is_full_range: bool) -> bytes:
        """Return the file of a picture in packed 4:2:2, as cameras give it; its chroma is kept as it is sampled.

        Args:
            data: Rows of ``Y U Y V``.
            width, height: Size [px]; the width is even.
            stride: Bytes from row to row.
            is_full_range: Whether luma runs from 0 to 255, as in a JPEG file, or from 16 to 235, as in television.
        """
        rows = np.frombuffer(data, dtype=np.uint8, count=stride * height).reshape(height, stride)[:, : 2 * width]
        y, u, v = (np.ascontiguousarray(rows[:, first::step]) for first, step in ((0, 2), (1, 4), (3, 4)))
        if not is_full_range:
            y, u, v = _LUMA[y], _CHROMA[u], _CHROMA[v]
        file: bytes = self._library.encode_jpeg_yuv_planes(y, u, v, quality=self.quality)
        return file


def library(module: str, package: str, who: str, *, extra: str = "video") -> Any:
    """Return a module of an extra.

    Raises:
        CameraError: it is not installed, or a library of the system that it needs is not.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError:
        raise CameraError(
            f"{who} needs {package}, which is not installed; pip install 'teleop-station[{extra}]'"
        ) from None
    except ImportError as error:
        raise CameraError(
            f"{who} needs {package}, which is installed and cannot be loaded ({error}); install that library with the "
            "system's packages"
        ) from None


def _stretched(centre: float, part: float) -> Bytes:
    values = (np.arange(256) - centre) / part + (128.0 if centre == 128.0 else 0.0)
    return np.asarray(values.round().clip(0, 255), dtype=np.uint8)


_LUMA, _CHROMA = _stretched(16.0, _STUDIO_LUMA), _stretched(128.0, _STUDIO_CHROMA)
