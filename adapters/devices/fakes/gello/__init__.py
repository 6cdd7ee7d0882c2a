"""Fake GELLO leaders under their makers' real libraries: servos on pseudo terminals, held by a script."""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path

from adapters.devices.fakes import script
from adapters.devices.fakes.gello.leader import FakeLeader, LeaderStep, arms_of, servos_of
from adapters.devices.fakes.script import Clock


class FakeGello:
    """The leaders of a script, from now until `close`.

    Args:
        file: The script.
        clock: Tells the time [s].
        folder: Where the ports and calibrations appear; a temporary one without it.
        start_s: Time of the script to begin at [s].

    Attributes:
        leaders: They, left before right.
        servos: Whose servos they have.
        folder: In place of ``/dev/serial/by-id``.
        calibrations: The folder of their calibrations.

    Raises:
        BadFile: the script cannot be read.
    """

    def __init__(
        self, file: Path, clock: Clock = time.monotonic, folder: Path | None = None, start_s: float = 0.0
    ) -> None:
        steps = script.load(file, "gello", LeaderStep)
        arms = arms_of(steps, file)
        self.servos = servos_of(steps, file)
        self._is_temporary = folder is None
        self.folder = folder or Path(tempfile.mkdtemp(prefix="fake-gello-"))
        self.calibrations = self.folder / "calibrations"
        self.leaders = [FakeLeader(arm, steps, clock, self.folder, start_s, self.servos) for arm in arms]

    def begin(self) -> None:
        """Start the script's clock: until then the leaders are held as at that time, and nothing goes wrong."""
        for leader in self.leaders:
            leader.begin()

    def close(self) -> None:
        """Take the ports away."""
        for leader in self.leaders:
            leader.close()
        if self._is_temporary:
            shutil.rmtree(self.folder, ignore_errors=True)
