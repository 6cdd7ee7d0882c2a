"""The same work on a Ray cluster; needs the extra ``ray``.

A cluster's machines need this package in the same version, and the same paths for episodes and for what is made of
them. Ray runs what its driver sends: connect only to a cluster, and through a network, that you trust.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import shutil
import socket
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from secrets import token_hex
from typing import Any, TypeVar

from station.errors import StationError, UsageError

T = TypeVar("T")
R = TypeVar("R")

LOCAL = "local"
_AHEAD = 1000  # tasks that Ray knows of at a time: enough for a cluster to grow by, few enough to keep track of
_RETRIES = 1  # of a task whose worker or machine died; a task that reports its own failure is not tried again
_REACH_S = 5.0
_REMOVALS, _MOMENT_S = 100, 0.1  # of its folder, until its last process has ended
_HOST_PORT = re.compile(r"(?:ray://)?(?P<host>[^/\s:]+|\[[^]]+\]):(?P<port>\d{1,5})")
_QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",  # Ray would tell its makers of each run
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # else it warns of a change to come
    "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0",
}


def run(
    work: Callable[[T], R],
    tasks: Sequence[T],
    *,
    address: str,
    jobs: int = 0,
    on_done: Callable[[R], None] | None = None,
    on_death: Callable[[T, str], R],
) -> list[R]:
    """Do a piece of work for each task on a cluster, one core each.

    Args:
        work: As of `station.side_by_side.run`.
        tasks: Given out in this order.
        address: ``host:port`` or ``ray://host:port`` of a cluster, ``auto`` for the one that this machine belongs to,
            ``local`` to start one here that ends with this call.
        jobs: Workers of one that is started here; 0 for one per core.
        on_done: Called in this process with each result as it comes.
        on_death: Gives the result of a task whose worker died, twice, from the task and a line that says how.

    Returns:
        The results, in the order of the tasks.

    Raises:
        UsageError: the address is none.
        StationError: Ray is not installed, or the cluster cannot be reached, or was lost; or the work raised it.
    """
    results: dict[int, R] = {}
    with _connected(address, jobs) as ray:
        remote = ray.remote(num_cpus=1, max_retries=_RETRIES, retry_exceptions=False)(_do)
        for number, reference in _as_they_come(ray, lambda task: remote.remote(work, task), tasks):
            results[number] = _result(ray, reference, partial(on_death, tasks[number]))
            if on_done is not None:
                on_done(results[number])
    return [results[number] for number in range(len(tasks))]


def _do(work: Callable[[T], R], task: T) -> R:
    return work(task)


def _as_they_come(ray: Any, submit: Callable[[T], Any], tasks: Sequence[T]) -> Iterator[tuple[int, Any]]:
    """Yield the number of each task that is done, and the reference to its result."""
    waiting = deque(range(len(tasks)))
    pending: dict[Any, int] = {}
    while waiting or pending:
        while waiting and len(pending) < _AHEAD:
            number = waiting.popleft()
            pending[submit(tasks[number])] = number
        ready, _ = ray.wait(list(pending), num_returns=1)
        for reference in ready:
            yield pending.pop(reference), reference


def _result(ray: Any, reference: Any, dead: Callable[[str], R]) -> R:
    try:
        result: R = ray.get(reference)
        return result
    except ray.exceptions.RayTaskError as error:
        cause = error.cause
        raise cause if isinstance(cause, StationError) else StationError(f"Ray: {_line(error)}") from None
    except (ray.exceptions.WorkerCrashedError, ray.exceptions.OutOfMemoryError, ray.exceptions.NodeDiedError) as error:
        return dead(f"the Ray worker that had it died: {_line(error)}")
    except ray.exceptions.RayError as error:
        raise StationError(f"Ray: {_line(error)}") from error


@contextmanager
def _connected(address: str, jobs: int) -> Iterator[Any]:
    """Join a cluster, or start one, give the library, and leave whole what was started."""
    if address != LOCAL:
        _see_that_it_is_there(address)
        with _joined(_import_ray(), address) as ray:
            yield ray
        return
    # It runs whatever it is sent, so no other user may find it: loopback, a token, a folder of its own.
    os.environ |= {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_AUTH_MODE": "token"}
    os.environ.setdefault("RAY_AUTH_TOKEN", token_hex(32))  # one for the life of this process: Ray remembers it
    folder = tempfile.mkdtemp(prefix="ray-")
    options = {"num_cpus": jobs or os.cpu_count() or 1, "include_dashboard": False, "_temp_dir": folder}
    try:
        with _joined(_import_ray(), address, **options) as ray:
            yield ray
    finally:
        _remove(folder)


def _remove(folder: str) -> None:
    """Remove Ray's folder, into which its last processes, which it does not wait for, may write for a moment."""
    for _ in range(_REMOVALS):
        shutil.rmtree(folder, ignore_errors=True)
        if not os.path.exists(folder):
            return
        time.sleep(_MOMENT_S)


@contextmanager
def _joined(ray: Any, address: str, **options: Any) -> Iterator[Any]:
    with contextlib.redirect_stdout(sys.stderr):  # where Ray tells of workers that died: no part of our result
        try:
            ray.init(address, log_to_driver=False, logging_level=logging.ERROR, **options)
        except (ray.exceptions.RayError, ConnectionError, RuntimeError, ValueError, OSError) as error:
            wants = (
                "" if "RAY_AUTH_MODE" in os.environ else "; if it wants a token: RAY_AUTH_MODE=token, RAY_AUTH_TOKEN"
            )
            raise StationError(f"--ray {address}: {_line(error)}{wants}") from error
        try:
            yield ray
        finally:
            ray.shutdown()


def _see_that_it_is_there(address: str) -> None:
    """Refuse an address at which no server answers, within seconds: Ray's own patience is minutes."""
    match = _HOST_PORT.fullmatch(address)
    if match is None:
        if address != "auto":
            raise UsageError(f"--ray {address!r}: expected host:port, ray://host:port, auto or {LOCAL}")
        return
    host, port = match["host"].strip("[]"), int(match["port"])
    try:
        socket.create_connection((host, port), timeout=_REACH_S).close()
    except (OSError, OverflowError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise StationError(f"--ray {address}: nothing answers there ({why}); `ray start --head` starts one") from None


def _import_ray() -> Any:
    for name, value in _QUIET.items():
        os.environ.setdefault(name, value)
    try:
        import ray
        import ray.exceptions
    except ModuleNotFoundError as error:
        raise StationError(f"--ray needs {error.name}; install the extra: pip install 'teleop-station[ray]'") from None
    return ray


def _line(error: BaseException) -> str:
    """Return the first sentence that says something."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0].split(". ")[0].rstrip(".") if lines else type(error).__name__
