"""The clock of a table: instants at a fixed rate, put where a little jitter of the writers changes nothing."""

from __future__ import annotations

import numpy as np

from station.episode.reading.messages import Ints

NANOSECONDS = 1_000_000_000

_LATEST = 99  # percentile of the writes that a tick shall come after
_MARGIN = 0.05  # of the writers' period
_STEADY = 0.5  # length of the mean of the phases as unit vectors: 1 when all agree, 0 when they are anywhere


def ticks(first_ns: int, last_ns: int, fps: int, pace_ns: Ints) -> Ints:
    """Return the instants of a table, ascending; none when the last comes before the first.

    They are exactly 1/fps apart. The first one comes less than a period of the pace after `first_ns`, where most
    writes of the pace (the robot's state) are just over. Ticks that fell on the writes themselves would see, by a few
    microseconds of jitter, one value twice and the next one never.

    Args:
        first_ns, last_ns: Where the table may begin and must end [ns since the epoch].
        fps: Rate [Hz].
        pace_ns: When the values were written that the rows are made of, ascending.
    """
    start_ns = first_ns + _delay_ns(first_ns, fps, pace_ns)
    if start_ns > last_ns:
        start_ns = first_ns
    count = (last_ns - start_ns) * fps // NANOSECONDS + 1
    steps = np.arange(max(count, 0), dtype=np.int64)
    return start_ns + steps * NANOSECONDS // fps


def period_ns(times_ns: Ints) -> int:
    """Return the usual time between two writes, 0 for fewer than two [ns]."""
    return int(np.median(np.diff(times_ns))) if len(times_ns) > 1 else 0


def _delay_ns(first_ns: int, fps: int, pace_ns: Ints) -> int:
    """Return how long after an instant the writes of a steady pace are over, 0 for an unsteady one [ns]."""
    period = period_ns(pace_ns)
    if period <= 0:
        return 0
    rate = fps * max(1, round(NANOSECONDS / (fps * period)))  # of the clock, or as many times as fast
    angles = (pace_ns - first_ns) * rate % NANOSECONDS * (2 * np.pi / NANOSECONDS)
    mean = np.exp(1j * angles).mean()
    if abs(mean) < _STEADY:
        return 0
    off = np.angle(np.exp(1j * (angles - np.angle(mean))))  # -pi to pi: early or late
    over = np.angle(mean) + np.percentile(off, _LATEST) + 2 * np.pi * _MARGIN
    return int(over % (2 * np.pi) * NANOSECONDS / (2 * np.pi * rate))
