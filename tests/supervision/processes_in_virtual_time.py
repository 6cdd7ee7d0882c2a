"""Child processes in virtual time, in the place of the operating system's: the supervisor above them is the real one.

A child says what a server says (`station.life.server`): its health on the bus, in its states; it reads its pipe.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import msgspec
import pytest

from station.bus import keys, stamp
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.life import supervisor_pipe
from station.life.restarts import RESTARTS_VARIABLE
from station.life.server import HEARTBEAT_S, Health, State
from tests.virtual.clock import Process, VirtualClock

_LOOK_S = 0.01
_FIRST_PID = 1 << 22  # beyond those that the system gives


class Script(msgspec.Struct, frozen=True, kw_only=True):
    """What one life of a server is.

    Attributes:
        loads_s: Time from its start to its first word, and to its being inactive [s].
        lives_s: Time from its being active to its end; None for as long as it is let [s].
        code: With which it then ends, or the signal that ends it as a negative number.
        ends_s: How long it takes to end when asked [s]; None for one that is deaf.
        silent_after_s: Time from its being active after which it says nothing more [s]; None for never.
        dies_loading: Whether it ends at the end of its loading.
    """

    loads_s: float = 0.5
    lives_s: float | None = None
    code: int = 1
    ends_s: float | None = 0.1
    silent_after_s: float | None = None
    dies_loading: bool = False


class FakeProcess:
    """As much of `subprocess.Popen` as the supervisor uses.

    Attributes:
        started_s, go_s, asked_s, killed_s, ended_s: When; None for not yet.
        restarts: What its environment tells of restarts.
    """

    def __init__(
        self, place: Processes, arguments: Sequence[str], descriptor: int, environment: dict[str, str]
    ) -> None:
        self.name = arguments[arguments.index("--name") + 1]
        self.restarts = int(environment[RESTARTS_VARIABLE])
        self.pid = _FIRST_PID + len(place.started)
        self.returncode: int | None = None
        self.started_s = place.clock.monotonic_s()
        self.go_s: float | None = None
        self.asked_s: float | None = None
        self.killed_s: float | None = None
        self.ended_s: float | None = None
        self.script = place.next_script(self.name)
        self._place, self._clock, self._supervisor_pipe = place, place.clock, os.dup(descriptor)
        os.set_blocking(self._supervisor_pipe, False)
        self._told = b""
        self._process: Process = place.clock.spawn(self._live, self.name)

    def poll(self) -> int | None:
        return self.returncode

    def wait(self, timeout_s: float | None = None) -> int:
        deadline_ns = None if timeout_s is None else self._clock.monotonic_ns() + round(timeout_s * 1e9)
        self._clock.hold(f"the end of {self.name}", lambda: self.returncode is not None, deadline_ns)
        if self.returncode is None:
            raise subprocess.TimeoutExpired(self.name, timeout_s or 0.0)
        return self.returncode

    def terminate(self) -> None:
        if self.asked_s is None:
            self.asked_s = self._clock.monotonic_s()

    def kill(self) -> None:
        if self.returncode is None:
            self.killed_s = self._clock.monotonic_s()
            self._clock.kill(self._process)
            self._end(-signal.SIGKILL)

    def _end(self, code: int) -> None:
        self.returncode, self.ended_s = code, self._clock.monotonic_s()
        os.close(self._supervisor_pipe)

    def _live(self) -> None:
        script, clock = self.script, self._clock
        if self._passes(script.loads_s):
            return self._end(-signal.SIGTERM)
        if script.dies_loading:
            return self._end(script.code)
        with Bus(self._place.address, name=self.name, timeout_s=1.0) as bus:
            self._say(bus, "inactive")
            while not self._hears(b"go"):
                if self._passes(_LOOK_S):
                    return self._end(0)
            self.go_s = active_s = clock.monotonic_s()
            while True:
                lived_s = clock.monotonic_s() - active_s
                if script.silent_after_s is None or lived_s < script.silent_after_s:
                    self._say(bus, "active")
                left_s = HEARTBEAT_S if script.lives_s is None else min(HEARTBEAT_S, script.lives_s - lived_s)
                if left_s <= 0.0:
                    return self._end(script.code)
                if self._passes(left_s):
                    clock.sleep(script.ends_s or 0.0)
                    self._say(bus, "finalized")
                    return self._end(0)

    def _passes(self, seconds: float) -> bool:
        """Let time pass; return whether it is asked to end meanwhile, and hears it."""
        deadline_ns = self._clock.monotonic_ns() + round(seconds * 1e9)
        return self._clock.hold(
            "the end of its time", lambda: self.asked_s is not None and self.script.ends_s is not None, deadline_ns
        )

    def _hears(self, word: bytes) -> bool:
        with suppress(BlockingIOError):
            self._told += os.read(self._supervisor_pipe, 1024)
        return word in self._told.split(b"\n")

    def _say(self, bus: Bus, state: State) -> None:
        health = Health(
            name=self.name, role="sensor", state=state, pid=self.pid, host=socket.gethostname() + "-virtual",
            boot=stamp.boot_id(), source=bus.source, started_wall_ns=self._clock.wall_ns(),
            wall_ns=self._clock.wall_ns(),
        )  # fmt: skip
        bus.publish({keys.server(self.name): msgspec.json.encode(health)})


class Processes:
    """The system that starts them.

    Attributes:
        started: All that were started, in order.
        scripts: Of each server, what its next life is; the last one for all that follow.
    """

    def __init__(self, clock: VirtualClock, address: BusAddress) -> None:
        self.clock, self.address = clock, address
        self.started: list[FakeProcess] = []
        self.scripts: dict[str, Callable[[int], Script]] = {}

    def of(self, name: str) -> list[FakeProcess]:
        return [process for process in self.started if process.name == name]

    def next_script(self, name: str) -> Script:
        make = self.scripts.get(name, lambda life: Script())
        return make(len(self.of(name)))

    def popen(self, arguments: Sequence[str], *, env: dict[str, str], **_: Any) -> FakeProcess:
        self.started.append(FakeProcess(self, arguments, int(env[supervisor_pipe.ENVIRONMENT_VARIABLE]), env))
        return self.started[-1]


@contextmanager
def processes_in(clock: VirtualClock, address: BusAddress) -> Iterator[Processes]:
    """Let whoever starts a process start one in virtual time."""
    made = Processes(clock, address)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("subprocess.Popen", made.popen)
        yield made
