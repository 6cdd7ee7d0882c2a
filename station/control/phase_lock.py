"""Keeps a loop's ticks just behind the commands that it uses, so that no command waits for most of a period.

A commander and a loop that both run at 50 Hz keep the offset that chance gave them: each command is up to 20 ms old
when it is used, for as long as both run. The offset can be measured from the arrivals, and a loop can move its ticks.
"""

from __future__ import annotations

import cmath
import math

_MEMORY = 25  # commands that the measured phase is a mean of
_STEADY = 0.95  # mean resultant length: arrivals scatter by a twentieth of a period, or drift by 0.2 % of it per tick
_LEAST_WAIT_S = 0.001  # from arrival to tick
_STEP = 0.01  # of a period per tick, at most: 0.2 ms at 50 Hz


class PhaseLock:
    """Says by how much the next ticks of a loop are to be moved.

    Ticks follow a commander whose rate is the loop's, a multiple or a fraction of it. From the arrivals' phase within
    the loop's period follow where the ticks should be: behind the usual arrival by 1 ms and twice the scatter. They
    move there by at most a hundredth of a period per tick. Where arrivals scatter more, or drift through the period as
    those of a commander at another rate do, ticks stay where they are.

    Args:
        period_s: The loop's period [s].

    Attributes:
        is_locked: Whether the ticks stand where they should.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self.is_locked = False
        self._source, self._mean, self._moved_s = "", 0j, 0.0

    def on_tick(self, source: str, age_s: float) -> float:
        """Take a command that a tick is the first to use; return how much later the next ticks should come [s].

        Args:
            source: The command's writer.
            age_s: How long before the tick it arrived [s].
        """
        if source != self._source:
            self._source, self._mean = source, 0j
        # Where it would be in the period had the ticks not been moved: what moves the ticks does not blur the mean.
        angle = 2.0 * math.pi * (age_s - self._moved_s) / self._period_s
        self._mean += (cmath.rect(1.0, angle) - self._mean) / _MEMORY
        steadiness = abs(self._mean)
        self.is_locked = False
        if steadiness < _STEADY:
            return 0.0
        scatter_s = math.sqrt(-2.0 * math.log(min(steadiness, 1.0))) * self._period_s / (2.0 * math.pi)
        wait_s = (cmath.phase(self._mean) * self._period_s / (2.0 * math.pi) + self._moved_s) % self._period_s
        late_s = wait_s - _LEAST_WAIT_S - 2.0 * scatter_s
        step_s = _STEP * self._period_s
        move_s = -min(max(late_s, -step_s), step_s)
        self.is_locked = abs(late_s) <= step_s
        self._moved_s += move_s
        return move_s
