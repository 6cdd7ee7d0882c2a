"""The newest sample of an operator's device, or why there is none that may be used.

Fresh is what arrived here a moment ago, was written a moment ago (where that is known, on one machine), and is live by
the device server's own word: none of them alone is enough, because a device server may be dead, a line may have been
frozen, and a living server may have lost its device.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from station.bus import codec
from station.bus.sample import Sample
from station.bus.watch import Watch
from station.operator import sample as readings
from station.operator.sample import OperatorSample, Status

STALE_S = 0.1
"""A device server that has not spoken for longer is silent [s]; it speaks with every tick."""

LATE_S = 0.25
"""Nobody drives by a sample that took longer to come [s]: a line that was frozen delivers those of seconds ago at once.
Its buttons count all the same, the stop among them."""


@dataclass(frozen=True, slots=True, eq=False)
class DeviceSample:
    """What was heard in a tick.

    Attributes:
        sample: The newest sample; None when there is none that may be used.
        why_not: Why there is none, or why it holds buttons only and is not to be driven by; else "".
        number: Count of samples by the device server's own counting, for the source of a command.
    """

    sample: OperatorSample | None
    why_not: str = ""
    number: int = 0


class DeviceSubscriber:
    """Listens to a device, or to one that gives poses and another that has the buttons.

    Args:
        watch: Watches the keys of `watched`.
        device: Name of the device server.
        controls_from: Name of another whose controls count in place of the device's own; "" for its own.
    """

    def __init__(self, watch: Watch, device: str, controls_from: str = "") -> None:
        self._one = _DeviceListener(watch, device)
        self._other = _DeviceListener(watch, controls_from) if controls_from else None

    @staticmethod
    def watched(device: str, controls_from: str = "") -> Sequence[str]:
        """Return the keys that must be watched."""
        return [key for name in (device, controls_from) if name for key in readings.watched_keys(name)]

    def poll(self) -> DeviceSample:
        """Return what is known now; buttons of another device count while poses are lost too, the stop among them."""
        heard = self._one.poll()
        if self._other is None:
            return heard
        other = self._other.poll()
        if other.sample is None:
            return DeviceSample(None, other.why_not, heard.number)
        sample = replace(heard.sample or OperatorSample(), controls=other.sample.controls)
        return DeviceSample(sample, heard.why_not or other.why_not, heard.number)


class _DeviceListener:
    """Listens to one device server."""

    def __init__(self, watch: Watch, device: str) -> None:
        self._watch, self._device = watch, device
        self._keys = readings.watched_keys(device)
        self._status_key = self._keys[0]
        self._newest: tuple[Status, OperatorSample] | None = None

    def poll(self) -> DeviceSample:
        told = self._watch.latest(self._status_key)
        if told is None:
            return DeviceSample(None, f"nothing was ever heard of {self._device}; is its server started?")
        age_s = told.age_s(self._watch.clock.monotonic_ns())
        if age_s > STALE_S:
            since = "" if math.isinf(age_s) else f" for {age_s:.1f} s"
            return DeviceSample(None, f"{self._device} is silent{since}")
        samples = {key: found for key in self._keys if (found := self._watch.latest(key)) is not None}
        try:
            status = readings.decode_status(self._device, samples)
            if status is None:
                return DeviceSample(None, f"{self._device} is silent")
            if status.state != "live":
                why = f": {status.reason}" if status.reason else ""
                return DeviceSample(None, f"{self._device} is {status.state}{why}", status.new)
            sample, late = self._decoded(status, samples), self._why_late(told)
            return DeviceSample(OperatorSample(controls=sample.controls) if late else sample, late, status.new)
        except codec.BadValue as error:
            return DeviceSample(None, str(error))

    def _why_late(self, told: Sample) -> str:
        is_late = told.delay_s is not None and told.delay_s > LATE_S
        return f"samples of {self._device} come {told.delay_s:.1f} s late" if is_late else ""

    def _decoded(self, status: Status, samples: dict[str, Sample]) -> OperatorSample:
        """Return the sample, decoded once: a tick without a new one gives the same object."""
        known = self._newest
        if known is None or (known[0].new, known[0].capture_ns, known[0].parts) != (
            status.new, status.capture_ns, status.parts,
        ):  # fmt: skip
            self._newest = known = (status, readings.decode(self._device, samples))
        return known[1]
