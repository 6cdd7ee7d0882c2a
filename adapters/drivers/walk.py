"""The driver `walk`: sticks or keys walk, turn, squat; the arms swing along."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from adapters.commands.twist2 import FORMAT
from adapters.drivers.body_on_legs import BodyOnLegs
from station.operator.deadman import Snapshot
from station.operator.driver import DriverInput
from station.operator.sample import OperatorSample
from station.protocols import CommandFormat, Floats


class WalkDriver:
    """Implements `station.operator.driver.Driver`; triggers and grips close and open the hands, where there are any."""

    name = "walk"
    mode = ""

    def __init__(self) -> None:
        self._body = BodyOnLegs()
        self._held: Snapshot[Any, Any] | None = None

    @property
    def command_format(self) -> CommandFormat:
        """TWIST2's."""
        return FORMAT

    @property
    def target(self) -> None:
        """Velocities are counted from zero."""
        return

    @property
    def auxiliary(self) -> Mapping[str, Floats]:
        """Both Dex3 hands, and the neck at rest."""
        return self._body.auxiliary

    @property
    def is_still(self) -> bool:
        """Whether the legs stand."""
        return self._body.is_standing

    def inspect(self, sample: OperatorSample) -> DriverInput:
        """Any controls will do."""
        return DriverInput(sample.controls) if sample.controls else DriverInput(None, "the device sends no controls")

    def jump(self, before: Any, now: Any) -> str:
        """Sticks do not jump."""
        return ""

    def next_mode(self) -> str:
        """There is but one."""
        return self.mode

    def step(self, sample: OperatorSample | None, snapshot: Snapshot[Any, Any] | None, dt_s: float) -> Floats:
        """Go on for a period; without a snapshot the legs come to a stand."""
        wish = self._body.sticks.rest()
        if snapshot is not self._held:
            self._held = snapshot
            if snapshot is not None:
                return self._body.begin()
        elif snapshot is not None and sample is not None:
            wish = self._body.sticks.wish(sample.controls, dt_s)
            self._body.fingers.step(sample.controls, dt_s)
        return self._body.send(wish, dt_s)

    def resume_from(self, command: Floats) -> None:
        """Start from a command that another writer gave, shape (m,)."""
        self._body.resume_from(command)

    def facts(self) -> dict[str, Any]:
        """Return the name."""
        return {"driver": self.name}
