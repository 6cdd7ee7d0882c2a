"""`Station` for programs on asyncio: the same line, and nothing that is asked of it holds up the event loop."""

from __future__ import annotations

import asyncio
import contextlib
import functools
from collections.abc import AsyncIterator, Callable, Coroutine, Generator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Concatenate, Generic, ParamSpec, Self, TypeVar

from station.api.live import MotionPlayer, Record, Station, Value
from station.life.events import Event

_MOST = 16  # requests at a time; further ones wait for their turn

BlockingT = TypeVar("BlockingT")
ResultT = TypeVar("ResultT")
ParametersT = ParamSpec("ParametersT")


class _Asynchronous(Generic[BlockingT]):
    """Asks a blocking object in threads."""

    def __init__(self, blocking: BlockingT, threads: ThreadPoolExecutor) -> None:
        self._blocking, self._threads = blocking, threads

    async def _run(self, call: Callable[[], ResultT]) -> ResultT:
        return await asyncio.get_running_loop().run_in_executor(self._threads, call)


def _awaited(
    method: Callable[Concatenate[BlockingT, ParametersT], ResultT],
) -> Callable[Concatenate[_Asynchronous[BlockingT], ParametersT], Coroutine[Any, Any, ResultT]]:
    """Return a method with the same arguments, result and errors, to be awaited."""

    @functools.wraps(method)
    async def awaited(
        self: _Asynchronous[BlockingT], /, *args: ParametersT.args, **kwargs: ParametersT.kwargs
    ) -> ResultT:
        return await self._run(functools.partial(method, self._blocking, *args, **kwargs))

    return awaited


class AsyncRecord(_Asynchronous[Record]):
    """`Record`, each method to be awaited."""

    start = _awaited(Record.start)
    stop = _awaited(Record.stop)
    mark = _awaited(Record.mark)
    discard = _awaited(Record.discard)
    status = _awaited(Record.status)


class AsyncMotionPlayer(_Asynchronous[MotionPlayer]):
    """`MotionPlayer`, each method to be awaited."""

    start = _awaited(MotionPlayer.start)
    pause = _awaited(MotionPlayer.pause)
    resume = _awaited(MotionPlayer.resume)
    seek = _awaited(MotionPlayer.seek)
    loop = _awaited(MotionPlayer.loop)
    leave = _awaited(MotionPlayer.leave)


class AsyncStation(_Asynchronous[Station]):
    """A line to a running station, for asyncio; an asynchronous context manager, which connects when it is entered.

    What is cancelled is not waited for any more; what was asked of the station by then, it does.

    Args:
        bus, name: As of `Station`, with its errors.

    Attributes:
        record, motion: As of `Station`, to be awaited.
    """

    record: AsyncRecord
    motion: AsyncMotionPlayer

    def __init__(self, bus: str | None = None, *, name: str = "script") -> None:
        self._open = functools.partial(Station, bus, name=name)

    async def __aenter__(self) -> Self:
        self._threads = ThreadPoolExecutor(_MOST, "station")
        try:
            self._blocking = await self._run(self._open)
        except BaseException:
            self._threads.shutdown(wait=False)
            raise
        self.record = AsyncRecord(self._blocking.record, self._threads)
        self.motion = AsyncMotionPlayer(self._blocking.motion, self._threads)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._run(self._blocking.close)
        self._threads.shutdown(wait=False, cancel_futures=True)

    servers = _awaited(Station.servers)
    robots = _awaited(Station.robots)
    wait_for_robot = _awaited(Station.wait_for_robot)
    keys = _awaited(Station.keys)
    contracts = _awaited(Station.contracts)
    describe = _awaited(Station.describe)
    description = _awaited(Station.description)
    read = _awaited(Station.read)
    cloud = _awaited(Station.cloud)
    publish = _awaited(Station.publish)
    estop = _awaited(Station.estop)
    release = _awaited(Station.release)
    arm = _awaited(Station.arm)
    disarm = _awaited(Station.disarm)
    release_motors = _awaited(Station.release_motors)
    policies = _awaited(Station.policies)
    switch_policy = _awaited(Station.switch_policy)
    runbook = _awaited(Station.runbook)
    answer = _awaited(Station.answer)

    async def follow(self, key: str, *, silent_s: float | None = None) -> AsyncIterator[Value]:
        """Begin to follow a key; return what yields each newest value, as `Station.follow`."""
        return await _Items[Value].begin(functools.partial(self._blocking.follow_or_none, key, silent_s=silent_s))

    async def events(self, *, silent_s: float | None = None) -> AsyncIterator[Event]:
        """Begin to listen; return what yields each event from now on, as `Station.events`."""
        return await _Items[Event].begin(functools.partial(self._blocking.events_or_none, silent_s=silent_s))


class _Items(AsyncIterator[ResultT]):
    """Items of a blocking iterator, which has a thread of its own and yields None where there was none for a moment."""

    def __init__(self, items: Generator[ResultT | None], thread: ThreadPoolExecutor) -> None:
        self._items, self._thread = items, thread
        self._is_over = False

    @classmethod
    async def begin(cls, begin: Callable[[], Generator[ResultT | None]]) -> Self:
        """Call what begins to listen, and return what it gives."""
        thread = ThreadPoolExecutor(1, "station-items")
        try:
            return cls(await asyncio.get_running_loop().run_in_executor(thread, begin), thread)
        except BaseException:
            thread.shutdown(wait=False)
            raise

    async def __anext__(self) -> ResultT:
        while not self._is_over:
            found = await asyncio.get_running_loop().run_in_executor(self._thread, self._next)
            if found is not None:
                return found
        raise StopAsyncIteration

    async def aclose(self) -> None:
        """Stop listening."""
        self._end()

    def __del__(self) -> None:
        with contextlib.suppress(RuntimeError):  # after Ctrl-C the interpreter may end first, and takes no more work
            self._end()

    def _next(self) -> ResultT | None:
        for found in self._items:
            return found
        self._end()
        return None

    def _end(self) -> None:
        if not self._is_over:
            self._is_over = True
            self._thread.submit(self._items.close)  # after what runs in the thread now
            self._thread.shutdown(wait=False)
