"""One function for every episode: in processes of this machine, or on a Ray cluster. A bad episode ends nothing.

What is done with an episode is the same function either way; it and its item travel by pickle, so it stands at the
top of a module, and on a cluster every machine has this package and sees the same paths.
"""

from __future__ import annotations

import errno
import logging
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from station import side_by_side
from station.errors import StationError

log = logging.getLogger(__name__)

T = TypeVar("T")
R = TypeVar("R")

_DISK_REFUSES = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)


@dataclass(frozen=True, slots=True)
class Attempt(Generic[T, R]):
    """What became of one item.

    Attributes:
        item: What was given to the function.
        result: What it returned; None where it failed.
        error: Why it failed, in one line; "" where it did not.
        seconds: How long it took where it ran [s].
        is_disk_at_fault: Whether it failed because the disk takes no more.
    """

    item: T
    result: R | None
    error: str = ""
    seconds: float = 0.0
    is_disk_at_fault: bool = False


class DiskRefuses(StationError):
    """The disk takes no more: no other episode would fare better; `item` is what it took no more of."""

    def __init__(self, message: str, item: object) -> None:
        super().__init__(message)
        self.item = item


def map_episodes(
    fn: Callable[[T], R],
    items: Sequence[T],
    *,
    jobs: int = 0,
    ray_address: str | None = None,
    on_done: Callable[[Attempt[T, R]], None] | None = None,
) -> list[Attempt[T, R]]:
    """Apply a function to each item; one that fails, however it fails, leaves the others as they are.

    Args:
        fn: A function at the top of a module; it raises `StationError` with one line where an item does not fit. What
            it leaves behind must be whole or nothing at any instant: a process may be killed, an item run twice.
        items: Given out in this order, one to a process at a time.
        jobs: Processes; 0 for one per core, 1 for this process alone. Of a Ray that is started here, its workers.
        ray_address: As `station.export.on_ray.run` takes it; None for processes of this machine.
        on_done: Called in this process with each attempt as it ends, in any order.

    Returns:
        The attempts, in the order of the items.

    Raises:
        DiskRefuses: the disk is full or may not be written: the rest is not tried.
        StationError: Ray is not installed, or its cluster cannot be reached, or was lost.
        KeyboardInterrupt: Ctrl-C; all processes have ended then.
    """
    work = _Guarded(fn)

    def on_result(attempt: Attempt[T, R]) -> None:
        if attempt.is_disk_at_fault:
            raise DiskRefuses(attempt.error, attempt.item)
        if on_done is not None:
            on_done(attempt)

    if ray_address is None:
        return side_by_side.run(work, items, jobs=jobs, on_done=on_result, on_death=_died)
    from station.export import on_ray

    return on_ray.run(work, items, address=ray_address, jobs=jobs, on_done=on_result, on_death=_died)


class _Guarded(Generic[T, R]):
    """A function that returns its errors."""

    def __init__(self, fn: Callable[[T], R]) -> None:
        self._fn = fn

    def __call__(self, item: T) -> Attempt[T, R]:
        began_s, is_disk_at_fault = time.monotonic(), False
        try:
            return Attempt(item, self._fn(item), seconds=time.monotonic() - began_s)
        except StationError as error:
            why = str(error)
        except OSError as error:
            is_disk_at_fault = error.errno in _DISK_REFUSES
            what = os.strerror(error.errno or 0) if is_disk_at_fault else error.strerror or error  # of some libraries
            why = f"{error.filename or 'the disk'}: {what}"
        except Exception as error:  # a fault of ours in one episode must not cost the other thousands
            log.debug("%r", item, exc_info=True)
            why = f"internal error: {_where(error)}: {type(error).__name__}: {error}"
        return Attempt(item, None, " ".join(why.split()), time.monotonic() - began_s, is_disk_at_fault)


def _where(error: BaseException) -> str:
    """Return the place of an error in our code, as a developer looks it up."""
    trace: Any = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return "?" if trace is None else f"{trace.tb_frame.f_globals.get('__name__', '?')} line {trace.tb_lineno}"


def _died(item: T, how: str) -> Attempt[T, Any]:
    return Attempt(item, None, how)
