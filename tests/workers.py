"""How many processes run tests together (``make test``): two a processor where it is fast, since many tests wait.

Where it is slow there is one: the robots that four tests simulate in real time then take all that two processors have,
and nothing is left for what records them.
"""

from __future__ import annotations

import os
import time

MOST = 4
"""On two processors six are no faster."""

_ADDITIONS = 1_000_000
_SLOW_S = 0.05  # for these; where they took 0.03 s four processes were right, where they took 0.07 s two


def count(processors: int, additions_s: float) -> int:
    """Return how many processes run tests.

    Args:
        processors: That they may use.
        additions_s: How long a million additions take here [s].
    """
    return min(MOST, processors if additions_s > _SLOW_S else 2 * processors)


def here() -> int:
    """Return how many run tests on this machine, as fast as it is now."""
    return count(len(os.sched_getaffinity(0)), min(_timed() for _ in range(5)))


def _timed() -> float:
    began_s, total = time.perf_counter(), 0
    for number in range(_ADDITIONS):
        total += number
    return time.perf_counter() - began_s
