"""Samples of a device by the bus, gathered for a while: for calibrations, not for control."""

from __future__ import annotations

from collections.abc import Callable

from station.bus.client import Bus
from station.errors import NotReady
from station.operator.device_subscriber import DeviceSubscriber
from station.operator.sample import OperatorSample

_LOOK_S = 0.004  # a headset sends every 11 to 14 ms
_LASTS_S = 1.5  # what is over before is not told


class Gatherer:
    """Hears a device server; a context manager.

    Args:
        bus: Where it speaks.
        device: Name of the device server.
    """

    def __init__(self, bus: Bus, device: str) -> None:
        self._device, self._clock = device, bus.clock
        self._watch = bus.watch(DeviceSubscriber.watched(device))
        self._subscriber = DeviceSubscriber(self._watch, device)

    def wait_for(
        self,
        why_not: Callable[[OperatorSample], str],
        within_s: float,
        tell: Callable[[str], None],
        look: Callable[[], None],
    ) -> None:
        """Wait for a sample without a flaw.

        Args:
            why_not: Says what a sample lacks, or "".
            within_s: How long to wait [s].
            tell: Is told why there is none yet, where a reason lasts.
            look: Called again and again; may raise what makes waiting useless.

        Raises:
            NotReady: there was none in time; says why.
        """
        began_s = since_s = self._clock.monotonic_s()
        told = why = ""
        while reason := self._lack(why_not):
            look()
            now_s = self._clock.monotonic_s()
            if now_s - began_s > within_s:
                raise NotReady(f"{self._device}: nothing to measure within {within_s:g} s: {reason}")
            if reason != why:
                why, since_s = reason, now_s
            elif reason != told and now_s - since_s > _LASTS_S:
                told = reason
                tell(reason)
            self._clock.sleep(_LOOK_S)

    def gather(self, why_not: Callable[[OperatorSample], str], for_s: float) -> list[OperatorSample]:
        """Return the samples without a flaw that come within a time [s], each once.

        Raises:
            NotReady: none came; says why.
        """
        found: list[OperatorSample] = []
        seen, ends_s, why = -1, self._clock.monotonic_s() + for_s, ""
        while self._clock.monotonic_s() < ends_s:
            heard = self._subscriber.poll()
            if heard.sample is None:
                why = heard.why_not
            elif heard.number != seen:
                seen = heard.number
                if not (lack := why_not(heard.sample)):
                    found.append(heard.sample)
                why = lack or why
            self._clock.sleep(_LOOK_S)
        if not found:
            raise NotReady(f"{self._device}: no sample came within {for_s:g} s: {why}")
        return found

    def close(self) -> None:
        """Stop listening."""
        self._watch.close()

    def __enter__(self) -> Gatherer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _lack(self, why_not: Callable[[OperatorSample], str]) -> str:
        heard = self._subscriber.poll()
        return heard.why_not if heard.sample is None else why_not(heard.sample)
