"""What a station remembers of the emergency stop: on the bus, which may be restarted, and in the stop's file.

A stopped low-level server says its stop again by itself (`station.control.low_level`); but it may have died as well,
or be none of ours, which keeps no file.
"""

from __future__ import annotations

import contextlib
from types import TracebackType

from station.bus import keys
from station.bus.client import Bus
from station.bus.sample import Sample
from station.errors import BusError
from station.life import estop
from station.life.stop_file import LatchedStop, StopKeeper, on_bus


class StopMemory:
    """Watches the key; a context manager.

    Args:
        bus: The station's.
        who: The name under which a stop is said again.
    """

    def __init__(self, bus: Bus, who: str) -> None:
        self._bus, self._who = bus, who
        self._watch = bus.watch(estop.KEYS)
        self._connections = self._watch.connections
        self._keeper = StopKeeper(bus.address)
        self._kept: dict[str, Sample] = {}

    def poll(self) -> str:
        """Keep a new stop in the file; say one again that the bus has forgotten, and return its reason, else "".

        Raises:
            BusError: it was not taken; the next call tries again.
        """
        self._keep()
        if not self.has_forgetful_bus:
            return ""
        connections, found = self._watch.connections, estop.latched(self._watch.latest)
        is_said = found is not None and estop.restate(self._bus, found[0].reason, self._who)
        self._connections = connections
        return found[0].reason if found is not None and is_said else ""

    def latched(self) -> LatchedStop | None:
        """Return the stop that nobody has released, by the file or by the bus; or None.

        The bus is asked: of a stop or a release of this moment no word may have come yet. What was heard counts where
        the bus does not answer, or has forgotten it.
        """
        self._keep()
        found = {keys.ESTOP: self._watch.latest(keys.ESTOP)}
        with contextlib.suppress(BusError):
            found |= self._bus.read(estop.KEYS)
        return self._keeper.file.read() or on_bus(self._bus.address, found.get)

    @property
    def has_forgetful_bus(self) -> bool:
        """Whether the bus went away and is back since the last `poll` that was heard: it may be another one."""
        return self._watch.connections != self._connections

    @property
    def is_stopped(self) -> bool:
        """Whether the stop is latched on the bus, as far as was heard."""
        return estop.latched(self._watch.latest) is not None

    def _keep(self) -> None:
        for key in estop.KEYS:
            sample = self._watch.latest(key)  # what a restarted bus has not stays here as it was
            if sample is None or sample is self._kept.get(key):
                continue
            self._kept[key] = sample
            if (request := estop.read(sample.value, key=key)).stop:
                self._keeper.latch(request.reason, sample.arrived_ns)

    def close(self) -> None:
        """Watch no more; what was latched is in the file."""
        self._keep()
        self._watch.close()
        self._keeper.close()

    def __enter__(self) -> StopMemory:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
