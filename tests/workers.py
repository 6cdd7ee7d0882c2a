"""Which tests run together (``make test``), in how many processes: two a processor where those are fast, as many wait.

Where they are slow there is one: the robots that four tests simulate in real time then take all that two processors
have, and neither is a robot twin punctual nor does a recorder get on.
"""

from __future__ import annotations

import functools
import multiprocessing
import os
import time
from pathlib import Path

from xdist.scheduler import LoadScopeScheduling

ROOT = Path(__file__).parents[1]
MOST = 4
"""On two processors six are no faster."""

_MILLIONS = 6  # of additions, by each processor
_SLOW_S = 0.055  # for a million; two threads of one core take 0.07 s together, where one alone takes 0.04 s


def count(processors: int, additions_s: float) -> int:
    """Return how many processes run tests.

    Args:
        processors: That they may use.
        additions_s: How long a million additions take on each of them, while all do that [s].
    """
    return min(MOST, processors if additions_s > _SLOW_S else 2 * processors)


def here() -> int:
    """Return how many run tests on this machine, as fast as it is now."""
    processors = len(os.sched_getaffinity(0))
    with multiprocessing.get_context("fork").Pool(processors) as pool:
        pool.map(_add, [1] * processors, chunksize=1)  # all are there
        began_s = time.perf_counter()
        pool.map(_add, [1_000_000 * _MILLIONS] * processors, chunksize=1)
        return count(processors, (time.perf_counter() - began_s) / _MILLIONS)


class OneTwinAtATime(LoadScopeScheduling):
    """Gives a process the tests of a module, and to one process all that ask for `real_time`: robot twins in real time.

    Each is sent 500 states a second by a process that has to be punctual, and two of them are not.
    """

    def _split_scope(self, nodeid: str) -> str:
        return "real_time" if _is_in_real_time(nodeid.partition("::")[0]) else str(super()._split_scope(nodeid))


@functools.cache
def _is_in_real_time(file: str) -> bool:
    return "real_time: None" in (ROOT / file).read_text(encoding="utf-8")


def _add(count: int) -> int:
    total = 0
    for number in range(count):
        total += number
    return total
