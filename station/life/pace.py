"""When the next command is due: by the clock, or when the robot has answered the one before."""

from __future__ import annotations

from typing import Any, Protocol

import msgspec

from station.bus.watch import Watch
from station.clock import SYSTEM, Clock
from station.life.loop import Rate
from station.life.server import Life

_SLICE_S = 0.05  # longest wait before a request to stop is seen
_GONE_S = 0.2  # who is asked to stop does not wait for a robot that has been silent for this long


class Pace(Protocol):
    """When the next command is due."""

    @property
    def state_seq(self) -> int | None:
        """Sequence number of the robot state that the next command answers; None without one."""
        ...

    def wait(self, *, is_leaving: bool) -> float:
        """Wait until then; return by how much motion time advances [s]."""
        ...

    def health(self) -> dict[str, Any]:
        """Return what the heartbeat says of the loop."""
        ...


class WallPace:
    """By the clock; time advances by one period per command, also after an overrun: late, but never a jump.

    Args:
        rate_hz: Commands per second [Hz].
        clock: The clock.
    """

    def __init__(self, rate_hz: float, clock: Clock = SYSTEM) -> None:
        self._rate, self._period_s = Rate(rate_hz, clock), 1.0 / rate_hz
        self._ticks, self._health = 0, dict[str, Any]()
        self._rate.wait()

    @property
    def state_seq(self) -> None:
        """The clock answers no robot state."""
        return

    def wait(self, *, is_leaving: bool) -> float:
        """Sleep until the next deadline; return one period [s]."""
        self._rate.wait()
        return self._period_s

    def health(self) -> dict[str, Any]:
        """Return rate, jitter and overruns, renewed twice a second at 50 Hz."""
        if self._ticks % 25 == 0:
            self._health = msgspec.structs.asdict(self._rate.stats())
        self._ticks += 1
        return self._health


class StatePace:
    """One command per robot state; by the clock once the robot is gone while we leave.

    Args:
        life: Says the events, knows of requests to stop, has the clock.
        watch: Watches `key`.
        key: Key of the robot state.
        rate_hz: One robot state stands for the reciprocal of this [Hz].
        patience_s: How long the robot may be silent before that is an event and the command is due again [s].
    """

    def __init__(self, life: Life, watch: Watch, key: str, rate_hz: float, *, patience_s: float) -> None:
        self._life, self._watch, self._key = life, watch, key
        self._period_s, self._patience_s = 1.0 / rate_hz, patience_s
        self._newest = watch.latest(key)  # answered already: the first command needs no state
        self._is_silent = False
        self._wakes: list[int] = []
        self._state_seq: int | None = None

    @property
    def state_seq(self) -> int | None:
        """Sequence number of the newest robot state; None before the first, or from a foreign writer."""
        return self._state_seq

    def wait(self, *, is_leaving: bool) -> float:
        """Return one period when a state came; zero when none did and the same command is due again."""
        clock = self._life.clock
        began_s = clock.monotonic_s()
        patience_s = self._period_s if is_leaving and self._is_silent else self._patience_s
        while (left_s := began_s + patience_s - clock.monotonic_s()) > 0:
            if self._next_state(min(left_s, _SLICE_S)):
                return self._period_s
            if self._life.stopping:
                if not is_leaving:
                    return 0.0
                patience_s = min(patience_s, _GONE_S)
        if not self._is_silent:
            self._is_silent = True
            self._life.event("robot-silent", severity="warning", key=self._key, waited_s=patience_s)
        return self._period_s if is_leaving else 0.0

    def health(self) -> dict[str, Any]:
        """Return the rate over the last 50 robot states."""
        if len(self._wakes) < 2:
            return {}
        return {"rate_hz": (len(self._wakes) - 1) / ((self._wakes[-1] - self._wakes[0]) * 1e-9)}

    def _next_state(self, timeout_s: float) -> bool:
        sample = self._watch.wait(self._key, after=self._newest, timeout_s=timeout_s)
        if sample is None:
            return False
        self._newest = sample
        self._state_seq = sample.stamp.seq if sample.stamp is not None else None
        self._wakes = [*self._wakes[-49:], self._life.clock.monotonic_ns()]
        if self._is_silent:
            self._is_silent = False
            self._life.event("robot-back", key=self._key)
        return True
