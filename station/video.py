"""Pictures to H.264 and back, by PyAV: loaded where it is used, so that a station without cameras needs none of it."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from station.errors import StationError

X264 = {"preset": "veryfast", "crf": "23", "bf": "0", "sc_threshold": "0"}
"""Settings of every H.264 video: no pictures that refer to later ones, so that order and number of the packets are
those of the pictures; no key frame where a scene changes: they come as often as was asked for."""

LOSSLESS_DB = 100.0
"""What the PSNR of equal pictures is called."""

_CODEC = "h264"
_NEVER = str(1 << 30)  # pictures from one key frame to the next: x264 takes it for infinite
_PIXELS = "yuvj420p"  # JPEG's own planes and range: nothing is converted before it is encoded
_FULL_RANGE, _BT601 = 2, 5  # AVCOL_RANGE_JPEG, AVCOL_SPC_BT470BG
_TICK = Fraction(1, 30)  # of the encoder's clock, by which it spends bits; a message has its own times
_QUALITY = 95  # of a JPEG file made of a video's picture: 48 dB to that, far beyond what the video keeps
_COMMENT, _LONGEST_MARK = b"\xff\xfe", 64  # marker of a JPEG file; bytes behind it

Plane = NDArray[np.uint8]


def library(name: str = "av", remedy: str = "") -> Any:
    """Return a library of the extra ``video``.

    Args:
        name: Its module.
        remedy: What else to do where it is not there.

    Raises:
        StationError: it cannot be loaded.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise StationError(
            f"video needs {name} ({error}); install it with `pip install 'teleop-station[video]'`{remedy}"
        ) from error


class JpegDecoder:
    """JPEG files to pictures, with PyAV's decoder: it keeps the camera's own colour planes, no detour through RGB."""

    def __init__(self) -> None:
        self._av = library()
        self._context = self._av.CodecContext.create("mjpeg", "r")
        self._context.thread_count = 1
        self._context.options = {"err_detect": "explode"}  # else half a picture is filled up with grey

    def picture(self, jpeg: bytes) -> Any | None:
        """Return an `av.VideoFrame`, or None for what is no whole JPEG file."""
        try:
            found = self._context.decode(self._av.Packet(jpeg)) if jpeg else []
        except (self._av.error.FFmpegError, ValueError):
            return None
        return found[0] if found else None


class VideoDecoder:
    """H.264 to JPEG files, picture by picture from a key frame on."""

    def __init__(self) -> None:
        self._av = library()
        self._context = self._av.CodecContext.create(_CODEC, "r")
        self._context.thread_count = 1  # several would hold pictures back

    def jpeg(self, data: bytes, mark: bytes) -> bytes:
        """Return the picture of the next packet as a JPEG file that has a comment.

        Raises:
            ValueError: it holds none, or not exactly one.
        """
        try:
            found = self._context.decode(self._av.Packet(data)) if data else []
        except self._av.error.FFmpegError as error:
            raise ValueError(f"{_CODEC}: {error.strerror or error}") from None
        if len(found) != 1:
            raise ValueError(f"{_CODEC}: {len(found)} pictures in a packet, expected one from a key frame on")
        mark = mark[:_LONGEST_MARK]
        file: bytes = library("simplejpeg").encode_jpeg_yuv_planes(*planes(found[0]), quality=_QUALITY)
        return file[:2] + _COMMENT + (len(mark) + 2).to_bytes(2) + mark + file[2:]


class VideoEncoder:
    """Makes H.264 of pictures of one size, Annex B: a key frame first, and none after it.

    One thread: episodes are encoded side by side, and the bytes do not depend on the machine.

    Args:
        width, height: Even numbers of pixels.
        crf: x264's constant rate factor, 0 to 51: the lower, the better and larger.
    """

    def __init__(self, width: int, height: int, *, crf: int) -> None:
        self._av = library()
        context = self._av.CodecContext.create("libx264", "w")
        context.width, context.height, context.pix_fmt = width, height, _PIXELS
        context.color_range, context.colorspace = _FULL_RANGE, _BT601
        context.time_base, context.thread_count = _TICK, 1
        context.options = {**X264, "crf": str(crf), "g": _NEVER}
        self._context, self._count = context, 0
        self._packets: list[bytes] = []

    def add(self, picture: Any) -> None:
        """Encode a picture as the next one; `in_planes` returned it, and it gets another time stamp."""
        # A frame decoded from JPEG is of type I, and encoders obey the type of a frame: each would be a key frame.
        picture.pict_type = self._av.video.frame.PictureType.NONE
        picture.pts, picture.time_base = self._count, _TICK
        self._count += 1
        self._packets += map(bytes, self._context.encode(picture))

    def finish(self) -> list[bytes]:
        """Return a packet for each picture."""
        return [*self._packets, *map(bytes, self._context.encode())]


def in_planes(picture: Any) -> Any:
    """Return a picture with the colour planes and the range that videos of pictures have."""
    return picture if picture.format.name == _PIXELS else picture.reformat(format=_PIXELS)


def planes(picture: Any) -> list[Plane]:
    """Return luma, shape (height, width), and the two chromas, each half as high and wide."""
    return [
        np.ascontiguousarray(
            np.frombuffer(plane, np.uint8, plane.height * plane.line_size)
            .reshape(plane.height, plane.line_size)[:, : plane.width]
        )
        for plane in picture.planes
    ]  # fmt: skip


def psnr_db(one: Sequence[Plane], other: Sequence[Plane]) -> float:
    """Return the peak signal-to-noise ratio over all samples, luma and chroma [dB]; `LOSSLESS_DB` at most."""
    total = sum(plane.size for plane in one)
    differences = (a.astype(np.int16) - b for a, b in zip(one, other, strict=True))
    squared = sum(int(np.einsum("ij,ij->", d, d, dtype=np.int64, casting="unsafe")) for d in differences)
    return min(LOSSLESS_DB, float(10.0 * np.log10(255.0**2 * total / squared))) if squared else LOSSLESS_DB
