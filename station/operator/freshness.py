"""How fresh a device's data are: live, stale, lost. Pure: it reads no clock."""

from __future__ import annotations

import math

from station.operator.sample import OperatorSample, State


class Freshness:
    """Judges by new samples, that is by changes of the device's own time stamp, on given monotonic times.

    A device that tells no time is taken to have a new sample whenever it gives a reading.

    Samples that begin to flow again must flow for `settle_s` before the device counts as live, so that one which sends
    too slowly is stale, and not live and stale in turns.

    Args:
        stale_after_s: Time without a new sample after which the device is stale [s].
        lost_after_s: And after which it is lost [s].
        settle_s: Time for which new samples must have come, none later than `stale_after_s`, to be live again [s].

    Attributes:
        state: The present state; ``lost`` before the first sample.
        new: Number of new samples so far.
        repeated: Number of steps without one.
        capture_ns: Device's time of the newest sample [ns]; None before it, or where the device tells no time.
    """

    def __init__(self, *, stale_after_s: float = 0.1, lost_after_s: float = 1.0, settle_s: float = 0.1) -> None:
        self.state: State = "lost"
        self.new = 0
        self.repeated = 0
        self.capture_ns: int | None = None
        self._stale_after_s, self._lost_after_s, self._settle_s = stale_after_s, lost_after_s, settle_s
        self._newest_s = -math.inf
        self._flowing_since_s = math.inf

    def silence_s(self, now_s: float) -> float:
        """Return the time since the newest sample [s]; infinite before the first."""
        return now_s - self._newest_s

    def step(self, now_s: float, reading: OperatorSample | None) -> bool:
        """Record what the device gave at a monotonic time [s]; return whether that is a new sample."""
        is_new = reading is not None and (reading.capture_ns is None or reading.capture_ns != self.capture_ns)
        silence_s = self.silence_s(now_s)
        self._judge(silence_s)  # before the sample counts: a gap between two steps is a gap
        if is_new and reading is not None:
            self.new += 1
            self.capture_ns = reading.capture_ns
            self._newest_s = now_s
            if silence_s > self._stale_after_s:
                self._flowing_since_s = now_s
            self._judge(0.0)
        else:
            self.repeated += 1
        return is_new

    def _judge(self, silence_s: float) -> None:
        if silence_s > self._lost_after_s:
            self.state = "lost"
        elif silence_s > self._stale_after_s:
            if self.state == "live":
                self.state = "stale"
        elif self._newest_s - self._flowing_since_s >= self._settle_s:
            self.state = "live"

    def lose(self) -> None:
        """Be lost at once: the device itself says that it is gone."""
        self.state = "lost"
        self._newest_s = -math.inf
