"""Keeps a server of our own alive: one that dies is started again at once, in the same place, with the same options.

What it held is gone, and is not missed: each process that finds its connection cut says again what it runs, and the
recorder measures what it did not hear.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from station.bus.address import BusAddress
from station.bus.redis_server import RedisServer
from station.bus.server_options import ServerOptions
from station.clock import SYSTEM, Clock, Thread
from station.errors import BusError

log = logging.getLogger(__name__)

_LOOK_S = 0.02  # clients try ten times a second; a start takes about as long as this
_SHORT_LIFE_S = 3.0
_FIRST_DELAY_S = 0.25
_LONGEST_DELAY_S = 4.0
_MOST_SHORT_LIVES = 6

OnRestart = Callable[[str], None]


class KeptServer:
    """A server that is there until `stop`; a context manager.

    A thread of its own starts it, again and again, and lives as long as it does: the kernel kills a server together
    with the thread that started it, so none outlives this process.

    Args:
        options: Where it listens.
        on_restart: Called in the keeper's thread, with what happened in a sentence.
        clock: By which it is looked after.

    Attributes:
        restarts: How often it was started again.
        error: Why it is no longer kept; None while it is.
    """

    def __init__(self, options: ServerOptions, on_restart: OnRestart | None = None, clock: Clock = SYSTEM) -> None:
        """Prepare one; `start` makes one that answers."""
        self.restarts = 0
        self.error: BusError | None = None
        self._options, self._clock = options, clock
        self._on_restart = on_restart
        self._server: RedisServer | None = None
        self._failure: Exception | None = None
        self._short_lives = 0
        self._began_s = 0.0
        self._started, self._closed = threading.Event(), threading.Event()
        self._thread: Thread | None = None

    @classmethod
    def start(cls, options: ServerOptions, on_restart: OnRestart | None = None) -> KeptServer:
        """Start a server and return once it answers.

        Args:
            options: Where it listens.
            on_restart: Called in the keeper's thread, with what happened in a sentence.

        Raises:
            ConfigError: neither a socket nor a port was asked for.
            BusError: it cannot be started; with its last words.
        """
        kept = cls(options, on_restart)
        kept._thread = kept._clock.start(kept._run, "bus-keeper")
        kept._clock.wait(kept._started)
        if kept._failure is not None:
            raise kept._failure
        return kept

    @property
    def address(self) -> BusAddress:
        """Where it is; the same after every restart."""
        return self._present.address

    @property
    def pid(self) -> int:
        """Process id of the server that is there now."""
        return self._present.pid

    def stop(self) -> None:
        """Stop the server for good; a second call does nothing."""
        self._closed.set()
        if self._thread is not None:
            self._clock.join(self._thread)

    def __enter__(self) -> KeptServer:
        """Return the running server."""
        return self

    def __exit__(self, *_: object) -> None:
        """Stop it."""
        self.stop()

    @property
    def _present(self) -> RedisServer:
        if self._server is None:
            raise RuntimeError("the server was not started")
        return self._server

    def _run(self) -> None:
        try:
            self._launch()
        except Exception as error:  # noqa: BLE001  raised where the start is waited for
            self._failure = error
            return
        finally:
            self._started.set()
        while not self._clock.wait(self._closed, _LOOK_S):
            if not self._present.is_running:
                self._restore()
        self._present.stop()

    def _launch(self) -> None:
        self._server = RedisServer.start(self._options)
        self._began_s = self._clock.monotonic_s()

    def _restore(self) -> None:
        """Start a server where one has died, unless that has been in vain too often."""
        how = self._present.ending
        is_short = self._clock.monotonic_s() - self._began_s < _SHORT_LIFE_S
        self._short_lives = self._short_lives + 1 if is_short else 0
        while self._short_lives < _MOST_SHORT_LIVES:
            if self._clock.wait(self._closed, self._delay_s):
                return
            try:
                self._launch()
            except BusError as error:  # no memory, or another server took its place
                how = str(error)
                self._short_lives += 1
                continue
            self.restarts += 1
            self._report(f"bus server {how}; started again, pid {self.pid}; what it held is gone")
            return
        self.error = BusError(f"bus {self.address}: its server {how}; it was started again in vain and is given up")
        self._report(str(self.error))
        self._clock.wait(self._closed)

    @property
    def _delay_s(self) -> float:
        if self._short_lives <= 1:
            return 0.0
        delay_s: float = _FIRST_DELAY_S * 2 ** (self._short_lives - 2)
        return min(_LONGEST_DELAY_S, delay_s)

    def _report(self, text: str) -> None:
        log.warning("%s", text)
        if self._on_restart is not None:
            self._on_restart(text)
