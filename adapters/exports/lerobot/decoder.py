"""JPEG files to pictures."""

from __future__ import annotations

from typing import Any

from adapters.exports.lerobot.av_library import av


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
