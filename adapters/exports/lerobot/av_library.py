"""PyAV, or one line that says how to get it."""

from __future__ import annotations

from typing import Any, Literal

from station import video

Codec = Literal["h264", "av1"]

PIXELS = "yuv420p"
"""Colour planes of every video: what all decoders read."""

DEPTH_PIXELS = "gray12le"
"""Of depth."""

av: Any = video.library(remedy=", or leave the pictures out with --camera none")
Decoder = video.JpegDecoder
