"""A clock whose time passes only while all threads wait: what runs on it runs as fast as it computes, and repeatably.

Threads are real and take turns: exactly one runs, until it waits by the clock. Then one that is ready goes on, drawn by
the seed where several are; where none is, time jumps to the earliest deadline. So each seed is one order of events out
of those that are possible, and the same one each time.
"""

from __future__ import annotations

import heapq
import random
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Self

from station.clock import Clock

_BEGIN_NS = 1_000_000_000_000
_BEGIN_WALL_NS = 1_700_000_000_000_000_000
_MOST_TURNS = 100_000  # without any time passing: two threads hand over to each other for ever
_ENDS_WITHIN_S = 10.0


class Deadlock(AssertionError):
    """No thread is ready, and none has a deadline; or time does not pass any more."""


class ThreadFailed(AssertionError):
    """An exception ended a thread; it is the cause of this one."""


class Abandoned(BaseException):
    """Raised in the threads that are left when the clock is closed."""


@dataclass(eq=False)
class Process:
    """Threads that are frozen and killed together, as those of an operating system's process are.

    Attributes:
        name: For people.
        frozen_until_ns: None of its threads runs before this instant.
        is_killed: Whether none of them runs ever again.
        on_kill: Called when it is killed: what the kernel does then.
    """

    name: str
    frozen_until_ns: int = 0
    is_killed: bool = False
    on_kill: list[Callable[[], None]] = field(default_factory=list)


class _Thread:
    """A thread that takes turns with the others, and what it waits for."""

    def __init__(self, name: str, process: Process) -> None:
        self.name, self.process = name, process
        self.turn = threading.Lock()
        self.turn.acquire()
        self.what = "its first turn"
        self.is_ready: Callable[[], bool] | None = None
        self.deadline_ns: int | None = 0
        self.error: BaseException | None = None
        self.real: threading.Thread | None = None

    def may_run(self, now_ns: int) -> bool:
        """Whether its wait is over."""
        if self.process.is_killed or now_ns < self.process.frozen_until_ns:
            return False
        if self.deadline_ns is not None and self.deadline_ns <= now_ns:
            return True
        return self.is_ready is not None and self.is_ready()

    def wakes_ns(self) -> int | None:
        """Return the instant from which time alone lets it run, or look whether it may; None where time does not."""
        if self.process.is_killed:
            return None
        if self.is_ready is not None and self.is_ready():
            return self.process.frozen_until_ns  # or it would be running
        return None if self.deadline_ns is None else max(self.deadline_ns, self.process.frozen_until_ns)


class VirtualClock(Clock):
    """A clock in virtual time, and the scheduler of the threads that use it; a context manager.

    The thread that makes it takes part. Whoever else uses it has to be started by `start` or `spawn`.

    Args:
        seed: Decides every order that is free.
        late_ns: A thread that waits for an instant wakes up to so much later, as on a real machine [ns].
        read_ns: How much time a look at the clock takes [ns].

    Attributes:
        seed: As given.
        random: The generator of this run; whatever else of a trial is random draws from it.
        wall_ahead_ns: How far the wall clock has been set forward since the start, or back [ns].
    """

    def __init__(self, seed: int = 0, *, late_ns: int = 0, read_ns: int = 0) -> None:
        self.seed, self.random = seed, random.Random(seed)
        self.wall_ahead_ns = 0
        self._late_ns, self._read_ns = late_ns, read_ns
        self._now_ns = _BEGIN_NS
        self._turns = self._count = 0
        self._timers: list[tuple[int, int, Callable[[], None]]] = []
        self._main = _Thread("main", Process("main"))
        self._main.real = threading.current_thread()
        self._running = self._main
        self._threads = [self._main]
        self._is_over = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the threads that are left."""
        self._is_over = True
        for thread in [thread for thread in self._threads if thread is not self._main]:
            thread.turn.release()
            assert thread.real is not None
            thread.real.join(_ENDS_WITHIN_S)
            assert not thread.real.is_alive(), f"{thread.name} does not end"

    def monotonic_ns(self) -> int:
        self._now_ns += self._read_ns
        return self._now_ns

    def wall_ns(self) -> int:
        return _BEGIN_WALL_NS + self.monotonic_ns() - _BEGIN_NS + self.wall_ahead_ns

    def sleep_until(self, instant_ns: int) -> None:
        self.hold("an instant", None, instant_ns)

    def wait(self, event: threading.Event, timeout_s: float | None = None) -> bool:
        return self.hold("an event", event.is_set, self._deadline_ns(timeout_s))

    def wait_for(
        self, condition: threading.Condition, predicate: Callable[[], bool], timeout_s: float | None = None
    ) -> bool:
        if predicate():
            return True
        condition.release()
        try:
            return self.hold("a condition", predicate, self._deadline_ns(timeout_s))
        finally:
            condition.acquire()

    def lock(self) -> AbstractContextManager[object]:
        return _Lock(self)

    def start(self, target: Callable[[], None], name: str) -> threading.Thread:
        return self._start(target, name, self._running.process)

    def join(self, thread: threading.Thread, timeout_s: float | None = None) -> None:
        def has_ended() -> bool:
            return all(other.real is not thread for other in self._threads)

        self.hold(f"the end of {thread.name}", has_ended, self._deadline_ns(timeout_s))

    @property
    def process(self) -> Process:
        """The process of the thread that runs."""
        return self._running.process

    def spawn(self, target: Callable[[], None], name: str) -> Process:
        """Start a process with a first thread."""
        process = Process(name)
        self._start(target, name, process)
        return process

    def freeze(self, process: Process, seconds: float) -> None:
        """Let no thread of a process run for a time [s], as SIGSTOP and SIGCONT do; for one's own from now on."""
        process.frozen_until_ns = max(process.frozen_until_ns, self._now_ns + round(seconds * 1e9))

    def kill(self, process: Process) -> None:
        """Let no thread of a process run any more, as SIGKILL does."""
        process.is_killed = True
        for action in process.on_kill:
            action()

    def is_running(self, process: Process) -> bool:
        """Whether a process has a thread that has not ended."""
        return not process.is_killed and any(thread.process is process for thread in self._threads)

    def until(self, condition: Callable[[], object], within_s: float = 60.0) -> None:
        """Wait until something holds that is asked every millisecond.

        Raises:
            AssertionError: it does not within a time [s].
        """
        end_ns = self._now_ns + round(within_s * 1e9)
        while not condition():
            assert self._now_ns < end_ns, f"not within {within_s:g} s (seed {self.seed})"
            self.sleep(0.001)

    def call_at(self, instant_ns: int, action: Callable[[], None]) -> None:
        """Have something done at an instant [ns] that waits for nothing: by a network, not by a process."""
        self._count += 1
        heapq.heappush(self._timers, (instant_ns, self._count, action))

    def hold(self, what: str, is_ready: Callable[[], bool] | None, deadline_ns: int | None) -> bool:
        """Let others run until a predicate holds or an instant [ns] has come; return whether the predicate holds.

        Args:
            what: What is waited for, for the report of a deadlock.
            is_ready: The predicate; it waits for nothing.
            deadline_ns: The instant; None to wait for as long as it takes.

        Raises:
            Deadlock: nothing can happen any more; in the thread that made the clock.
            ThreadFailed: another thread has ended with an exception; in the thread that made the clock.
        """
        me = self._running
        if threading.current_thread() is not me.real:
            raise RuntimeError(f"{threading.current_thread().name} was not started by the clock that it uses")
        if self._is_over:
            raise Abandoned
        if self._late_ns and deadline_ns is not None and deadline_ns > self._now_ns:
            deadline_ns += self.random.randrange(self._late_ns)
        me.what, me.is_ready, me.deadline_ns = what, is_ready, deadline_ns
        self._hand_over(me)
        if self._is_over:
            raise Abandoned
        if me.error is not None:
            error, me.error = me.error, None
            raise error
        return is_ready is not None and is_ready()

    def _deadline_ns(self, timeout_s: float | None) -> int | None:
        """Return the instant at which a wait ends; never now for one that is longer than nothing."""
        if timeout_s is None:
            return None
        return self._now_ns if timeout_s <= 0 else self._now_ns + max(1, round(timeout_s * 1e9))

    def _hand_over(self, me: _Thread | None) -> None:
        """Give the turn to one that is ready, and wait for the next turn of one's own, unless one ends."""
        chosen = self._choose()
        if chosen is me:
            return
        self._running = chosen
        chosen.turn.release()
        if me is not None:
            me.turn.acquire()

    def _choose(self) -> _Thread:
        if self._main.error is not None:
            return self._main
        while True:
            while self._timers and self._timers[0][0] <= self._now_ns:
                heapq.heappop(self._timers)[2]()
            ready = [thread for thread in self._threads if thread.may_run(self._now_ns)]
            if ready:
                break
            instants = [at_ns for thread in self._threads if (at_ns := thread.wakes_ns()) is not None]
            if self._timers:
                instants.append(self._timers[0][0])
            if not instants:
                return self._fail_main(Deadlock(f"nothing can happen any more (seed {self.seed}): {self._waits()}"))
            self._now_ns, self._turns = max(self._now_ns, min(instants)), 0
        self._turns += 1
        if self._turns > _MOST_TURNS:
            return self._fail_main(Deadlock(f"time does not pass any more (seed {self.seed}): {self._waits()}"))
        return ready[0] if len(ready) == 1 else self.random.choice(ready)

    def _fail_main(self, error: BaseException) -> _Thread:
        self._main.error = self._main.error or error
        return self._main

    def _waits(self) -> str:
        return "; ".join(f"{thread.process.name}/{thread.name} waits for {thread.what}" for thread in self._threads)

    def _start(self, target: Callable[[], None], name: str, process: Process) -> threading.Thread:
        thread = _Thread(name, process)

        def run() -> None:
            thread.turn.acquire()
            try:
                if not self._is_over:
                    target()
            except Abandoned:
                pass
            except BaseException as error:  # noqa: BLE001  the test's own thread raises it
                failed = ThreadFailed(f"{process.name}/{name}: {error!r} (seed {self.seed})")
                failed.__cause__ = error
                self._fail_main(failed)
            finally:
                self._threads.remove(thread)
                if not self._is_over:
                    self._hand_over(None)

        thread.real = threading.Thread(target=run, name=name, daemon=True)
        self._threads.append(thread)
        thread.real.start()
        return thread.real


class _Lock:
    """A lock whose holder may wait."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock, self._is_held = clock, False

    def __enter__(self) -> Self:
        if self._is_held:
            self._clock.hold("a lock", lambda: not self._is_held, None)
        self._is_held = True
        return self

    def __exit__(self, *_: object) -> None:
        self._is_held = False
