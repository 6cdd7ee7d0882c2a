"""Work of one kind done in several processes, which end when this one does, however it ends.

An interrupt from the keyboard, which reaches a whole process group, is left to this process; it takes its children
down. When it dies without doing so, each child sees that and ends at once.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Generic, TypeVar

import msgspec

from station.errors import StationError, UsageError

T = TypeVar("T")
R = TypeVar("R")

# Children are spawned: a forked copy of a process with threads (a runtime's, a bus client's) may hang.
_SPAWN = multiprocessing.get_context("spawn")


_NONE = -1
_END_S = 2.0  # for a process without a task to end by itself


class _Failed(msgspec.Struct, frozen=True):
    """An error of a child: exceptions do not always survive the way back, one line and its exit code do."""

    text: str
    is_usage: bool


class _Died(StationError):
    """A process ended in the middle of a task."""


class _Child(msgspec.Struct, Generic[T]):
    """A process, our end of the pipe to it, and the number of the task that it has; `_NONE` for none."""

    process: BaseProcess
    line: Connection
    task: int = _NONE


def processes(tasks: int, jobs: int) -> int:
    """Return how many processes do some tasks when the user wants `jobs`, 0 being one per core."""
    return max(1, min(tasks, jobs or os.cpu_count() or 1))


def run(
    work: Callable[[T], R],
    tasks: Sequence[T],
    *,
    jobs: int = 0,
    on_done: Callable[[R], None] | None = None,
    on_death: Callable[[T, str], R] | None = None,
) -> list[R]:
    """Do a piece of work for each task.

    Args:
        work: A function at the top of a module. What it loads it may keep: a process does many tasks.
        tasks: Given out in this order; they and the results travel as pickles.
        jobs: Processes; 0 for one per core, 1 for this process alone.
        on_done: Called in this process with each result as it comes, in any order.
        on_death: Gives the result of a task whose process died of it, from the task and a line that says how; another
            process takes its place. None: that is a problem as any other.

    Returns:
        The results, in the order of the tasks.

    Raises:
        StationError: a task failed, or a process died; the first problem ends the rest.
    """
    results: dict[int, R] = {}
    count = processes(len(tasks), jobs)
    with contextlib.closing(_alone(work, tasks) if count == 1 else _shared(work, tasks, count, on_death)) as done:
        for number, result in done:  # closed at once, so that no process works on where `on_done` ends it
            results[number] = result
            if on_done is not None:
                on_done(result)
    return [results[number] for number in range(len(tasks))]


def _alone(work: Callable[[T], R], tasks: Sequence[T]) -> Generator[tuple[int, R], None, None]:
    for number, task in enumerate(tasks):
        yield number, work(task)


def _shared(
    work: Callable[[T], R], tasks: Sequence[T], count: int, on_death: Callable[[T, str], R] | None
) -> Generator[tuple[int, R], None, None]:
    with _children(work, count) as children:
        waiting = iter(range(len(tasks)))
        busy = [child for child in children if _give(child, waiting, tasks)]
        while busy:
            ready = wait([child.line for child in busy])
            for child in [child for child in busy if child.line in ready]:
                number, heir = child.task, child
                try:
                    result = _answer(child)
                except _Died as death:
                    if on_death is None:
                        raise
                    result = on_death(tasks[number], str(death))
                    heir = _replace(child, children, work)
                busy.remove(child)
                heir.task = _NONE
                if _give(heir, waiting, tasks):
                    busy.append(heir)
                yield number, result


@contextmanager
def _children(work: Callable[[T], R], count: int) -> Iterator[list[_Child[T]]]:
    children: list[_Child[T]] = []
    try:
        with _interrupts_held_back():
            for _ in range(count):
                children.append(_start(work))
        yield children
    finally:
        for child in children:
            if child.task != _NONE:
                child.process.terminate()
            child.line.close()  # without a task it ends by itself, and gives back what its libraries took of the system
        for child in children:
            child.process.join(_END_S)
            child.process.terminate()
            child.process.join()


def _start(work: Callable[[T], R]) -> _Child[T]:
    ours, theirs = _SPAWN.Pipe()
    process = _SPAWN.Process(target=_serve, args=(work, theirs), daemon=True)
    process.start()
    theirs.close()  # else the pipe would not end when the child dies
    return _Child(process, ours)


def _replace(dead: _Child[T], children: list[_Child[T]], work: Callable[[T], R]) -> _Child[T]:
    """Start another process in the place of one that died."""
    dead.line.close()
    children.remove(dead)
    with _interrupts_held_back():
        children.append(_start(work))
    return children[-1]


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Let no interrupt come between the start of a child and our knowing of it; what is started here is deaf to them.

    Children inherit what the thread that starts them has blocked. Our own interrupt may yet come through a thread that
    some library has, and would be raised in this one: so it is noted, and raised when all children are known.
    """
    resource_tracker.ensure_running()  # the first start would start it, and lift our block as it does
    came: list[int] = []
    handler = signal.getsignal(signal.SIGINT)
    is_ours = callable(handler) and threading.current_thread() is threading.main_thread()
    if is_ours:
        signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if is_ours:
            signal.signal(signal.SIGINT, handler)
    if came:
        raise KeyboardInterrupt


def _give(child: _Child[T], waiting: Iterator[int], tasks: Sequence[T]) -> bool:
    number = next(waiting, None)
    if number is None:
        return False
    child.task = number
    with contextlib.suppress(BrokenPipeError):  # it is dead already: `_answer` tells
        child.line.send(tasks[number])
    return True


def _answer(child: _Child[T]) -> Any:
    try:
        result = child.line.recv()
    except (EOFError, ConnectionResetError):
        child.process.join()
        raise _Died(f"one of the processes that shared the work ended with {_ending(child.process.exitcode)}") from None
    if isinstance(result, _Failed):
        raise (UsageError if result.is_usage else StationError)(result.text)
    return result


def _ending(code: int | None) -> str:
    """Return how a process ended; one that is killed without a word most often took more memory than there is."""
    if code == -signal.SIGKILL:
        return "signal SIGKILL (is there enough memory? fewer --jobs take less)"
    return f"signal {signal.Signals(-code).name}" if code is not None and code < 0 else f"exit code {code}"


def _serve(work: Callable[[T], R], line: Connection) -> None:
    """Be a child."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    while True:
        try:
            task = line.recv()
        except EOFError:
            return
        try:
            line.send(work(task))
        except StationError as error:
            line.send(_Failed(str(error), isinstance(error, UsageError)))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)  # no process is left to tell
