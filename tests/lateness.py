"""Whether the machine was late: how long those who belong to a test waited for a processor, by the kernel's account.

A promise about time is asked for as it stands. Where it was not kept, the test says by how much, and how long the
threads that may have to do with it were kept waiting meanwhile; only a wait at least as long excuses that one round,
which is told, and another one follows. What is slow by itself waits for nobody and is found in the first round.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

ROUNDS = 6
EXCUSED = "excused, the machine was late"
PROOF_S = 0.002
"""A shorter wait proves nothing: threads of one station wait for each other so long on a machine of their own [s]."""

STALE_S = 0.1
"""So long without a sample a device is stale, so long without a command the gate holds [s]."""

log = logging.getLogger(__name__)

_LOOK_S = 0.2
_CHAIN = 4  # who writes, the bus, who hears of it, and the loop that acts
_T = TypeVar("_T")
_STEAL = 8  # column of the first line of /proc/stat
_NOT_THERE = (FileNotFoundError, ProcessLookupError)  # it has ended, or this kernel tells nothing: no excuse then


class Waits:
    """How long threads have waited for a processor since this was made: of this process and of all that it started.

    What was waited by a process that has ended counts as far as it was seen, see `watched`.

    Attributes:
        longest_s: The longest wait of a single thread between two looks [s].
    """

    def __init__(self) -> None:
        self._pids = {os.getpid()}  # and who is there now, though it may be an orphan later
        self._newest: dict[str, int] = {}
        self._one_at_a_time = threading.Lock()
        self.longest_s = 0.0
        self._is_over = False
        self._look()
        self._before, self._stolen_before_s, self.longest_s = dict(self._newest), self._stolen_s, 0.0

    def seconds(self) -> float:
        """Return how long a whole chain of threads may have waited: those that did so longest, and what the host of a
        virtual machine took from it [s]."""
        self._look()
        waited_ns = sorted(now - self._before.get(thread, 0) for thread, now in self._newest.items())
        return sum(waited_ns[-_CHAIN:]) * 1e-9 + self._stolen_s - self._stolen_before_s

    @classmethod
    @contextmanager
    def watched(cls) -> Iterator[Waits]:
        """Look again and again for the length of a block, in which processes may come and go; what is waited after it
        counts no more."""
        waits, ended = cls(), threading.Event()

        def watch() -> None:
            while not ended.wait(_LOOK_S):
                waits._look()

        thread = threading.Thread(target=watch, daemon=True)
        thread.start()
        try:
            yield waits
        finally:
            ended.set()
            thread.join()
            waits._look()
            waits._is_over = True

    def _look(self) -> None:
        if self._is_over:
            return
        self._stolen_s = _stolen_s()
        self._pids |= _descendants(os.getpid())
        found = _waited_ns(self._pids)
        with self._one_at_a_time:
            longest_ns = max((now - self._newest.get(thread, 0) for thread, now in found.items()), default=0)
            self.longest_s = max(self.longest_s, longest_ns * 1e-9)
            self._newest = self._newest | found


class TooLate(AssertionError):
    """A promise about time that was not kept.

    Args:
        what: What was late.
        late_s: By how much at least [s].
        waited_s: How long its processes waited for a processor meanwhile, see `Waits` [s].
    """

    def __init__(self, what: str, late_s: float, waited_s: float) -> None:
        self.is_of_the_machine = waited_s >= max(late_s, PROOF_S)
        super().__init__(f"{what}: late by {late_s:.3f} s or more, while who has to do with it waited {waited_s:.3f} s")


def in_time(trial: Callable[[], _T], rounds: int = ROUNDS) -> _T:
    """Return what comes of a trial: of another one where it was too late and the machine was the cause."""
    for left in range(rounds - 1, -1, -1):
        try:
            return trial()
        except TooLate as late:
            if not left:
                raise
            excuse(late)
    raise AssertionError("no round")


def excuse(late: TooLate) -> None:
    """Say that something was too late because of the machine, at the end of the run too; raise it if it was not."""
    if not late.is_of_the_machine:
        raise late
    log.warning("%s: %s", EXCUSED, late)


def _waited_ns(pids: set[int]) -> dict[str, int]:
    """Return how long each thread has waited in a queue of the scheduler so far [ns]."""
    found = {}
    for thread in (path for pid in pids for path in _threads(pid)):
        with suppress(*_NOT_THERE):
            found[thread.name] = int((thread / "schedstat").read_text().split()[1])
    return found


def _threads(pid: int) -> Iterator[Path]:
    with suppress(*_NOT_THERE):
        yield from Path(f"/proc/{pid}/task").iterdir()


def _descendants(pid: int) -> set[int]:
    found: set[int] = set()
    for thread in _threads(pid):
        with suppress(*_NOT_THERE):
            children = {int(child) for child in (thread / "children").read_text().split()}
            found |= children.union(*(_descendants(child) for child in children))
    return found


def _stolen_s() -> float:
    """Return the time that the host of a virtual machine gave to others so far, of each processor [s]."""
    with suppress(*_NOT_THERE):
        return (
            int(Path("/proc/stat").read_text().split(maxsplit=_STEAL + 1)[_STEAL])
            / os.sysconf("SC_CLK_TCK")
            / (os.cpu_count() or 1)
        )
    return 0.0
