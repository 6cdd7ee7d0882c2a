"""Which clips there are to be tracked on this machine."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from station import registry
from station.assets import inventory
from station.errors import AssetMissing
from station.suite.promise import HELD_BACK, UPSTREAM, WAVING, Clips


def find(named: Sequence[str] = ()) -> tuple[Clips, list[str]]:
    """Return the clips that are here, and those that are not: upstream's are not everywhere.

    Args:
        named: Clips of the user's, in place of the suite's own.

    Raises:
        StationError: a clip cannot be read, or one of the user's is not here.
    """
    load = registry.find("loader", "motion")
    durations_s: dict[str, float] = {}
    missing: list[str] = []
    with quietly():
        for reference in named or dict.fromkeys([*inventory.motions(), *UPSTREAM, *HELD_BACK]):
            try:
                if (motion := load(reference)).joint_names or named:  # of the suite's own: what can be tracked
                    durations_s[reference] = motion.duration_s
            except AssetMissing:
                if named:
                    raise
                missing.append(reference)
    return Clips(durations_s=durations_s, wave_s=load(WAVING).duration_s), missing


@contextmanager
def quietly() -> Iterator[None]:
    """Leave warnings unsaid: what was trimmed off a clip, each process would tell again; `rehearse CLIP` tells it."""
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)
