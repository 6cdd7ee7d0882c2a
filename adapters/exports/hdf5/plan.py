"""Everything that decides what the files are, but for the episodes."""

from __future__ import annotations

from typing import Literal

import msgspec

from adapters.exports.lerobot import plan as lerobot

Layout = Literal["robomimic", "act"]
Encoding = Literal["rgb", "jpeg"]


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """What all episodes have in common.

    Attributes:
        layout: Whose files they are.
        encoding: How pictures stand in them: pixels, or the bytes of the camera's JPEG files.
        rows: What a row is; the same as in a LeRobot data set of the same options.
    """

    layout: Layout
    encoding: Encoding
    rows: lerobot.Plan
