"""Fake gloves under the real pyserial: they write to pseudo terminals, and a script closes their fingers."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from adapters.devices.fakes import script
from adapters.devices.fakes.glove.hand import SIDES, FakeGlove, GloveStep, sides_of
from adapters.devices.fakes.script import Clock
from adapters.devices.glove.calibration import Side
from station.errors import BadFile


class FakeGloves:
    """The gloves of a script, from now until `close`.

    Args:
        file: The script.
        clock: Tells the time [s].
        folder: Where the ports and calibrations appear; a temporary one without it.
        sides: Which gloves, of those that the script moves; empty for all.
        start_s: Time of the script to begin at [s].

    Attributes:
        gloves: They, left before right.
        folder: In place of ``/dev/serial/by-id``.
        calibrations: The folder of their calibrations.

    Raises:
        BadFile: the script cannot be read, or moves another hand.
    """

    def __init__(
        self, file: Path, clock: Clock = time.monotonic, folder: Path | None = None, *, sides: Sequence[Side] = (),
        start_s: float = 0.0,
    ) -> None:  # fmt: skip
        steps = script.load(file, "glove", GloveStep)
        moved = sides_of(steps, file)
        for side in sides:
            if side not in moved:
                raise BadFile(f"{file}: moves no {side} hand, but {moved[0]}; set side: {moved[0]}")
        self._is_temporary = folder is None
        self.folder = folder or Path(tempfile.mkdtemp(prefix="fake-glove-"))
        self.calibrations = self.folder / "calibrations"
        chosen = [side for side in SIDES if side in (sides or moved)]
        self.gloves = [FakeGlove(side, steps, clock, self.folder, start_s) for side in chosen]

    def begin(self) -> None:
        """Start the script's clock: until then the hands are held as at that time, and nothing goes wrong."""
        for glove in self.gloves:
            glove.begin()

    def close(self) -> None:
        """Take the ports away."""
        for glove in self.gloves:
            glove.close()
        if self._is_temporary:
            shutil.rmtree(self.folder, ignore_errors=True)
