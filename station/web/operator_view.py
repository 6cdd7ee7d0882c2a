"""What an operator is shown on a page that drives a robot: pictures of cameras, and what happens, as cues."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable, Mapping, Sequence

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.errors import BusError
from station.operator.phrases import Phrases
from station.operator.station_monitor import StationMonitor
from station.operator.voice import Cue
from station.web.feeds import Frame

log = logging.getLogger(__name__)

_PERIOD_S = 1.0 / 60.0
_AGAIN_S = 0.5  # between two tries to reach a bus


class OperatorView:
    """Looks at the bus in a thread of its own until it is closed; a context manager.

    Args:
        address: The bus.
        name: The server's own, in the stamps; its heartbeat is not told of.
        cameras: Names of the cameras whose pictures are shown, by the name of their feed.
        show: Called with new pictures, by the name of their feed.
        tell: Called with what happens.
    """

    def __init__(
        self,
        address: BusAddress,
        name: str,
        cameras: Mapping[str, str],
        show: Callable[[Mapping[str, Frame]], object],
        tell: Callable[[Cue], object],
    ) -> None:
        self._address, self._name = address, name
        self._keys = {feed: keys.camera_image(camera) for feed, camera in cameras.items()}
        self._show, self._tell = show, tell
        self._stop, self._clock = threading.Event(), address.clock
        self._thread = self._clock.start(self._run, "operator-view")

    def close(self) -> None:
        """Look no more."""
        self._stop.set()
        self._clock.join(self._thread)

    def __enter__(self) -> OperatorView:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                with Bus(self._address, name=self._name) as bus, StationMonitor(bus, self._name) as monitor:
                    self._look(bus, monitor)
            except BusError as error:
                log.debug("%s; again in %g s", error, _AGAIN_S)
                self._clock.wait(self._stop, _AGAIN_S)

    def _look(self, bus: Bus, monitor: StationMonitor) -> None:
        table = Phrases()
        shown: dict[str, object] = {}
        with contextlib.ExitStack() as stack:
            watch = stack.enter_context(bus.watch(list(self._keys.values()))) if self._keys else None
            while not self._clock.wait(self._stop, _PERIOD_S):
                for event in monitor.poll():
                    if (cue := table.cue(event)) is not None:
                        self._tell(cue)
                new: dict[str, Frame] = {}
                for feed, key in self._keys.items():
                    sample = None if watch is None else watch.latest(key)
                    if sample is not None and shown.get(feed) is not sample:
                        shown[feed] = sample
                        taken_ns = sample.written_ns or sample.arrived_ns or self._clock.monotonic_ns()
                        new[feed] = Frame({"f": feed, "media": "image/jpeg"}, sample.value, taken_ns * 1e-9)
                if new:
                    self._show(new)


def feeds_of(cameras: Sequence[str]) -> dict[str, str]:
    """Return the cameras of both eyes by the name of their feed: one for both, or left and right."""
    return dict(zip(("eye:left", "eye:right"), cameras, strict=False))
