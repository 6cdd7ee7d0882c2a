"""How a video is encoded: names that need no library."""

from __future__ import annotations

from typing import Literal

Codec = Literal["h264", "av1"]

PIXELS = "yuv420p"
"""Colour planes of every video: what all decoders read."""
