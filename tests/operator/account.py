"""What a device server says on the bus, tick by tick, and the events beside it."""

from __future__ import annotations

from collections.abc import Callable
from itertools import groupby

from station.bus import keys, stamp
from station.bus.sample import Sample
from station.bus.tap import Tap, Write
from station.life import events
from station.life.events import Event
from station.operator import sample as readings
from station.operator.sample import OperatorSample, Status
from tests.waiting import wait_until


class Tick:
    """What the server wrote in one go."""

    def __init__(self, writes: list[Write]) -> None:
        self.values = {write.key: write.value or b"" for write in writes}
        self.stamps = {stamp.decode(write.stamp or b"") for write in writes}
        samples = {key: Sample(key, value, None, 0) for key, value in self.values.items()}
        self.status = readings.decode_status("pico", samples)
        self.reading = readings.decode("pico", samples) if keys.operator_head("pico") in samples else None


class Account:
    """Everything that was written to the bus, in order."""

    def __init__(self, tap: Tap) -> None:
        self._tap = tap
        self.ticks: list[Tick] = []
        self.events: list[Event] = []

    def take(self) -> None:
        for _, group in groupby(self._tap.read(0.05), lambda write: write.stamp and write.stamp.split()[1]):
            writes = list(group)
            if any(write.key == keys.operator_status("pico") for write in writes):
                self.ticks.append(Tick(writes))
            found = [events.decode(write.value or b"") for write in writes if write.key == keys.EVENT]
            self.events += [event for event in found if event is not None]

    def until(self, condition: Callable[[], object]) -> None:
        def holds() -> object:
            self.take()
            return condition()

        wait_until(holds, 60.0)

    def states(self) -> list[str]:
        """Return the states in order; that another reason is known is no other state."""
        told = [event.name.removeprefix("operator-") for event in self.events if event.name.startswith("operator-")]
        return [state for state, _ in groupby(told)]

    def told(self, name: str) -> int:
        return sum(event.name == name for event in self.events)

    def samples(self) -> list[OperatorSample]:
        return [tick.reading for tick in self.ticks if tick.reading is not None]

    def status(self) -> Status:
        status = self.ticks[-1].status if self.ticks else None
        return status or Status(state="lost")
