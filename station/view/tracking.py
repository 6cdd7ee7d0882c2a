"""How far each joint was from where it was asked to be, by the definition of `station.control.tracking`."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from station.protocols import Floats
from station.view.phases import TRACKING, Span
from station.view.run import Run


def joint_errors(run: Run) -> dict[str, float]:
    """Return the mean |measured - commanded| of each joint [rad]; empty where nothing can be compared.

    It counts while the motion plays and the gate tracks; the measured value is the last one before each command.
    """
    asked, measured = run.commanded, run.joints
    if asked is None or measured is None or not len(measured.q):
        return {}
    counts = within(asked.times_s, run.playing) if run.playing else np.full(len(asked.times_s), True)
    if run.gate:
        counts &= within(asked.times_s, [span for span in run.gate if span.name == TRACKING])
    before = np.searchsorted(measured.times_s, asked.times_s, side="right") - 1
    counts &= before >= 0
    errors = {}
    for column, name in enumerate(asked.names):
        if name in measured.names:
            differences = np.abs(measured.q[before, measured.names.index(name)] - asked.q[:, column])[counts]
            known = differences[np.isfinite(differences)]
            if len(known):
                errors[name] = float(known.mean())
    return errors


def within(times_s: Floats, spans: Iterable[Span]) -> NDArray[np.bool_]:
    """Return which instants lie within any of some spans, ends included, shape (n,)."""
    found = np.full(len(times_s), False)
    for span in spans:
        found |= (times_s >= span.start_s) & (times_s <= span.end_s)
    return found
