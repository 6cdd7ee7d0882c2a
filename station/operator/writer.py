"""What a teleoperation server writes: the command, what belongs to it, and where it comes from, in one atomic write."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from station.bus import codec, keys
from station.life.server import Life
from station.operator.device_subscriber import DeviceSample
from station.protocols import CommandFormat, Floats


class CommandWriter:
    """Writes commands.

    Args:
        life: Its bus is written to.
        form: Of the commands.
        device, driver: Whose they are, for their source.

    Attributes:
        newest: The newest command, shape (m,); None before the first.
        flaw: Why the newest command did not get away, or "".
    """

    def __init__(self, life: Life, form: CommandFormat, *, device: str, driver: str) -> None:
        self._life, self._form = life, form
        self._whose = {"kind": "operator", "device": device, "driver": driver}
        self.newest: Floats | None = None
        self.flaw = ""

    def write(self, command: Floats, companions: Mapping[str, Floats], heard: DeviceSample, **state: Any) -> None:
        """Write a command.

        Args:
            command: Shape (m,).
            companions: Values of the keys beside it.
            heard: The sample that it was made of.
            state: What else its source tells.
        """
        capture_ns = heard.reading.capture_ns if heard.reading is not None else None
        source = {**self._whose, **state, "sample": heard.sample, "capture_ns": capture_ns}
        beside = {key: codec.json_vector(value) for key, value in companions.items()}
        self._publish(command, beside | {keys.command_source(self._form.robot): codec.json_object(source)})

    def write_alone(self, command: Floats) -> None:
        """Write a command and nothing else, shape (m,)."""
        self._publish(command, {})

    def _publish(self, command: Floats, others: dict[str, bytes]) -> None:
        self.newest = command
        clocks = dict.fromkeys(self._form.stock.clocks, b"%d" % (self._life.clock.wall_ns() // 1_000_000))
        taken = self._life.bus.publish({self._form.key: codec.json_vector(command), **others, **clocks})
        self.flaw = "" if taken else "the bus is lost"
