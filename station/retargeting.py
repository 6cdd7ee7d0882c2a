"""Captures of people as motions of a robot: what is asked for one file, and what came of it.

A retargeter is registered by the name of its robot (``station.retargeters``); readers of captures by the suffix of
their files (``station.captures``).
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Protocol

import msgspec

from station import registry

Unit = Literal["m", "cm", "mm", "inch", "cmu"]
"""Of a capture's lengths; ``cmu`` is that of CMU's files."""


class RetargetTask(msgspec.Struct, frozen=True, kw_only=True):
    """One file to be retargeted.

    Attributes:
        source: The capture.
        target: The motion file to make.
        robot: Registered name of the retargeter.
        fps: Frames per second of the motion.
        units: Of the capture's lengths, None for what it says, or a guess.
        height_m: How tall the person is [m]; None for what the capture says.
        force: Whether another motion at the target is replaced.
    """

    source: Path
    target: Path
    robot: str
    fps: float
    units: Unit | None = None
    height_m: float | None = None
    force: bool = False


class Retargeted(msgspec.Struct, frozen=True, kw_only=True):
    """What came of a file.

    Attributes:
        source: The capture.
        target: The motion file; "" where none was written.
        is_kept: Whether the same motion was there before.
        seconds, fps, frames: Length [s], rate [Hz] and number of its frames.
        captured_fps: Rate of the capture [Hz].
        height_m: How tall the person is [m].
        unit: What a length in the capture is, in words.
        at_limit_s: By joint, for how long it was at an end of its range [s].
        slowed_s: By joint, or `root`, for how long it was as fast as it may be, and lagged behind [s].
        slide_mps: Mean speed of the robot's feet over the floor while they carry [m/s].
        notes: What was guessed, bridged or left out.
        why_not: Why the station would not play it; "" where it would.
    """

    source: str
    target: str = ""
    is_kept: bool = False
    seconds: float = 0.0
    fps: float = 0.0
    frames: int = 0
    captured_fps: float = 0.0
    height_m: float = 0.0
    unit: str = ""
    at_limit_s: dict[str, float] = {}
    slowed_s: dict[str, float] = {}
    slide_mps: float = 0.0
    notes: tuple[str, ...] = ()
    why_not: str = ""


class Retargeter(Protocol):
    """Makes a motion file of a capture."""

    def __call__(self, task: RetargetTask) -> Retargeted:
        """Retarget a file and write the motion; raises `station.errors.StationError` with one line."""
        ...


def retarget(task: RetargetTask) -> Retargeted:
    """Retarget a file by what is registered for its robot."""
    made: Retargeted = registry.find("retargeter", task.robot)(task)
    return made
