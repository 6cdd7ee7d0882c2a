"""The line between a supervisor and the servers it starts: a pipe that says "go", and breaks when the supervisor dies.

The supervisor holds the writing end. A line ``go`` activates the server; ``estop <reason>`` asks for the emergency
stop, which so reaches a robot also past a bus that is dead; end of file, which the kernel delivers even after
``kill -9`` of the supervisor, asks it to finish cleanly, and soon after makes it.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable

log = logging.getLogger(__name__)

ENVIRONMENT_VARIABLE = "STATION_SUPERVISOR_FD"
_LAST_WORD_S = 0.2
_UNNAMED = "the supervisor asked for it"
GRACE_S = 10.0  # longer than the 2 s blend of a command server and the closing of an episode


class SupervisorPipe:
    """A server's end of the line.

    Attributes:
        activated: Set by ``go``.
        on_estop: Called with the reason, in the pipe's thread, by ``estop``.
    """

    def __init__(self, descriptor: int, on_release: Callable[[], None]) -> None:
        self.activated = threading.Event()
        self.on_estop: Callable[[str], None] = lambda _: None
        self._descriptor = descriptor
        self._on_release = on_release
        threading.Thread(target=self._listen, name="supervisor-pipe", daemon=True).start()

    def _listen(self) -> None:
        with os.fdopen(self._descriptor, encoding="utf-8", errors="replace") as line:
            for said in line:
                word, _, reason = said.strip().partition(" ")
                if word == "go":
                    self.activated.set()
                elif word == "estop":
                    self.on_estop(reason or _UNNAMED)
        log.warning("the supervisor is gone; finishing")
        self._on_release()
        self.activated.set()
        watchdog = threading.Timer(GRACE_S, _die)
        watchdog.daemon = True
        watchdog.start()


def from_environment(on_release: Callable[[], None]) -> SupervisorPipe | None:
    """Return the pipe that the supervisor put into the environment; None for a server started by hand."""
    value = os.environ.pop(ENVIRONMENT_VARIABLE, None)
    return SupervisorPipe(int(value), on_release) if value else None


def _die() -> None:
    log.critical("not finished %.0f s after the supervisor was gone; giving up", GRACE_S)
    time.sleep(_LAST_WORD_S)  # a log that nobody takes does not keep it
    os._exit(1)
