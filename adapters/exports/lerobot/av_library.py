"""PyAV, or one line that says how to get it."""

from __future__ import annotations

import importlib
from typing import Any, Literal

from station.errors import StationError

Codec = Literal["h264", "av1"]

PIXELS = "yuv420p"
"""Colour planes of every video: what all decoders read."""


def _load() -> Any:
    try:
        return importlib.import_module("av")
    except ImportError as error:
        raise StationError(
            f"video needs PyAV ({error}); install it with `pip install 'teleop-station[video]'`, "
            "or leave the pictures out with --camera none"
        ) from error


av: Any = _load()


class Decoder:
    """JPEG files to pictures, with PyAV's decoder: it keeps the camera's own colour planes, no detour through RGB."""

    def __init__(self) -> None:
        self._context = av.CodecContext.create("mjpeg", "r")
        self._context.thread_count = 1
        self._context.options = {"err_detect": "explode"}  # else half a picture is filled up with grey

    def picture(self, jpeg: bytes) -> Any | None:
        """Return an `av.VideoFrame`, or None for what is no whole JPEG file."""
        try:
            found = self._context.decode(av.Packet(jpeg)) if jpeg else []
        except (av.error.FFmpegError, ValueError):
            return None
        return found[0] if found else None
