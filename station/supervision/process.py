"""One server process, as its supervisor has it: started with a pipe that it listens to, asked to finish, or killed.

`Process` is what a supervisor needs of one, on whatever machine it runs; `LocalProcess` is one of this machine, and
`station.supervision.hosts` has those of others.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

from station import python_child
from station.bus.address import BULK_VARIABLE, ENVIRONMENT_VARIABLE, NO_BULK, BusAddress, bulk_of
from station.clock import Clock
from station.life import supervisor_pipe
from station.life.restarts import RESTARTS_VARIABLE

_STACKS_S = 0.2  # writing them takes a millisecond, once the child is given a processor


class Process(Protocol):
    """One process of a server."""

    @property
    def pid(self) -> int:
        """Its id on its machine; 0 while that has not told it."""
        ...

    @property
    def log(self) -> Path | str:
        """Where it prints to."""
        ...

    def poll(self) -> int | None:
        """Return its exit code, or negative signal; None while it runs."""
        ...

    def wait(self, timeout_s: float | None = None) -> int:
        """Wait until it has ended; return its exit code.

        Raises:
            subprocess.TimeoutExpired: it has not within that time [s].
        """
        ...

    def go(self) -> None:
        """Let it become active."""
        ...

    def estop(self, reason: str) -> bool:
        """Ask it for the emergency stop, past the bus; return whether it was told: it runs, on this machine."""
        ...

    def terminate(self) -> None:
        """Ask it to finish."""
        ...

    def kill(self) -> None:
        """End it."""
        ...

    def write_stacks(self) -> bool:
        """Have it write to its log where each of its threads stands; return False where it cannot be asked."""
        ...

    def last_words(self) -> str:
        """Return the last line that it printed: its reason, when it ended by itself."""
        ...

    def close(self) -> None:
        """Have no more to do with it: one that runs still finishes by itself."""
        ...


class LocalProcess:
    """One of this machine.

    Args:
        arguments: Of ``station``.
        log: File that its output is appended to.
        bus: Where it says how it is doing.
        environment: Variables that it gets beside our own.
        clock: By which it is waited for.
        restarts: How often a process of this server was started before.
    """

    def __init__(
        self,
        arguments: Sequence[str],
        log: Path,
        bus: BusAddress,
        environment: Mapping[str, str],
        clock: Clock,
        restarts: int = 0,
    ) -> None:
        self.log, self._clock = log, clock
        self._pipe_lock = threading.Lock()  # an emergency stop comes from a thread of its own
        reading, self._pipe = os.pipe()
        os.set_inheritable(reading, True)
        bulk = bulk_of(bus)
        variables = {
            **os.environ,
            **environment,
            # In the environment, not among the arguments: a password must not show in the process list.
            ENVIRONMENT_VARIABLE: bus.url,
            BULK_VARIABLE: NO_BULK if bulk is None else bulk.url,
            supervisor_pipe.ENVIRONMENT_VARIABLE: str(reading),
            RESTARTS_VARIABLE: str(restarts),
            "PYTHONUNBUFFERED": "1",
        }
        with log.open("ab") as output:
            self._process = subprocess.Popen(
                python_child.command("-m", "station", *arguments),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                pass_fds=(reading,),
                env=variables,
                start_new_session=True,  # Ctrl-C in the terminal is ours to hear; the children stop in our order
            )
        os.close(reading)
        os.set_blocking(self._pipe, False)  # a frozen child, which reads nothing, must not hold us
        self.pid = self._process.pid

    def poll(self) -> int | None:
        """As `Process.poll`."""
        return self._process.poll()

    def wait(self, timeout_s: float | None = None) -> int:
        """As `Process.wait`."""
        return self._process.wait(timeout_s)

    def go(self) -> None:
        """As `Process.go`."""
        self._write(b"go\n")

    def estop(self, reason: str) -> bool:
        """As `Process.estop`; a child that is frozen was told, and obeys when it goes on."""
        return self._process.poll() is None and self._write(f"estop {reason}\n".encode())

    def terminate(self) -> None:
        """As `Process.terminate`."""
        self._process.terminate()

    def kill(self) -> None:
        """As `Process.kill`."""
        self._process.kill()

    def write_stacks(self) -> bool:
        """As `Process.write_stacks`; False for one that is too young to do so."""
        if not python_child.writes_stacks(self.pid):
            return False
        self._process.send_signal(python_child.STACKS)
        self._clock.sleep(_STACKS_S)
        return True

    def last_words(self) -> str:
        """As `Process.last_words`."""
        text = self.log.read_text(errors="replace") if self.log.exists() else ""
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        return lines[-1].removeprefix("station: ") if lines else f"it printed nothing to {self.log}"

    def close(self) -> None:
        """As `Process.close`."""
        with self._pipe_lock:
            if self._pipe >= 0:
                os.close(self._pipe)
            self._pipe = -1

    def _write(self, word: bytes) -> bool:
        """Say a word; return whether it has come, now or before: one that is frozen was told often enough."""
        with self._pipe_lock, contextlib.suppress(BrokenPipeError):
            if self._pipe >= 0:
                with contextlib.suppress(BlockingIOError):
                    os.write(self._pipe, word)
                return True
        return False
