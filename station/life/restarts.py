"""How often, and how soon, a server that dies is started again."""

from __future__ import annotations

RESTARTS_VARIABLE = "STATION_RESTARTS"
"""How often a supervisor has started this server again; unset for one that nobody supervises."""

_SHORT_LIFE_S = 3.0  # from its start; loading takes about one of them
_FIRST_DELAY_S = 0.25
_LONGEST_DELAY_S = 4.0
_MOST_SHORT_LIVES = 6
_USAGE = 2  # exit code of a server that will fail the same way again


class Restarts:
    """Counts the lives of one server.

    The first restart comes at once. One that dies young again and again is given longer and longer, and is given up
    after six short lives in a row; one that has lived for three seconds begins with a clean slate.

    Attributes:
        is_armed: Whether it was active once; one that never was has a fault that a restart does not mend.
        count: How often it was started again.
    """

    def __init__(self) -> None:
        self.is_armed = False
        self.count = 0
        self._short_lives = 0
        self._noted = 0

    def allow(self, code: int) -> bool:
        """Whether a server that ended with an exit code, or negative signal, is to be started again."""
        return self.is_armed and code not in (0, _USAGE) and self._short_lives < _MOST_SHORT_LIVES

    def has_noted(self, pid: int) -> bool:
        """Whether the death of a process was noted."""
        return self._noted == pid

    def record(self, pid: int, lived_s: float) -> None:
        """Record a death, once per process."""
        self._noted = pid
        self.count += 1
        self._short_lives = self._short_lives + 1 if lived_s < _SHORT_LIFE_S else 0

    def pardon(self) -> None:
        """Forget the short lives: a person starts it again."""
        self._short_lives = 0

    @property
    def delay_s(self) -> float:
        """Time from a death to the next start [s]."""
        if self._short_lives <= 1:
            return 0.0
        delay_s: float = _FIRST_DELAY_S * 2 ** (self._short_lives - 2)
        return min(_LONGEST_DELAY_S, delay_s)

    def why(self, how: str) -> str:
        """Return why it is not started again; `how` says how it ended."""
        if self._short_lives >= _MOST_SHORT_LIVES:
            return f"{how}; started again {self.count - 1} times, and it dies within {_SHORT_LIFE_S:g} s each time"
        return how
