"""What a station remembers of the emergency stop, for a bus that was restarted and for servers that start after that.

A stopped low-level server says its stop again by itself (`station.control.low_level`); but it may have died as well.
"""

from __future__ import annotations

from types import TracebackType

from station.bus import keys
from station.bus.client import Bus
from station.life import estop


class StopMemory:
    """Watches the key; a context manager.

    Args:
        bus: The station's.
        who: Who says a stop again.
    """

    def __init__(self, bus: Bus, who: str) -> None:
        self._bus, self._who = bus, who
        self._watch = bus.watch([keys.ESTOP])
        self._connections = self._watch.connections

    def look(self) -> str:
        """Say a stop again that the bus has forgotten; return its reason, or "" where nothing was to be said.

        Raises:
            BusError: it was not heard; the next call tries again.
        """
        if not self.has_forgetful_bus:
            return ""
        connections, request = self._watch.connections, self._newest()
        is_said = request is not None and request.stop and estop.restate(self._bus, request.reason, self._who)
        self._connections = connections
        return request.reason if request is not None and is_said else ""

    @property
    def has_forgetful_bus(self) -> bool:
        """Whether the bus went away and is back since the last `look` that was heard: it may be another one."""
        return self._watch.connections != self._connections

    @property
    def is_stopped(self) -> bool:
        """Whether the stop is latched, as far as was heard."""
        request = self._newest()
        return request is not None and request.stop

    def _newest(self) -> estop.StopRequest | None:
        sample = self._watch.latest(keys.ESTOP)  # what a restarted bus has not stays here as it was
        return estop.read(sample.value) if sample is not None else None

    def close(self) -> None:
        """Remember nothing more."""
        self._watch.close()

    def __enter__(self) -> StopMemory:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
