"""DDS domains of this machine, each for one test at a time: programs on the same one hear each other."""

from __future__ import annotations

import fcntl
import os
import random
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_OURS = range(1, 200)
_LOCKS = Path("/tmp")  # shared by all runs of the tests; their TMPDIR is not


@contextmanager
def domain(which: int | None = None) -> Iterator[int]:
    """Have a domain alone; one that is free, or a certain one as soon as it is."""
    candidates = [which] if which is not None else random.sample(_OURS, len(_OURS))
    descriptors = []
    try:
        for number in candidates:
            path = _LOCKS / f"station-test-dds-{os.getuid()}-{number}"
            descriptors.append(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600))
            try:
                fcntl.flock(descriptors[-1], fcntl.LOCK_EX | (fcntl.LOCK_NB if which is None else 0))
            except BlockingIOError:
                continue
            yield number
            return
        raise AssertionError("no DDS domain is free")
    finally:
        for descriptor in descriptors:
            os.close(descriptor)
