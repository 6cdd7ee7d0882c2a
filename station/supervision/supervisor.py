"""Starts servers as child processes, activates them in order, and never leaves one behind.

A child loads everything and then waits, inactive, for "go" on its pipe (`station.life.supervisor_pipe`); so the slow
part of a start runs in parallel and the order of a runbook still holds. A child that dies takes nothing silently with
it: its last words are kept. A recorder that dies is started again (`station.life.restarts`), since its episode waits
for it; whatever moves a robot is not, unless a runbook or a person says so (`station.supervision.exit_policy`). When
the supervisor itself is killed, every pipe breaks and the children finish by themselves.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from station import config as configuration
from station import python_child
from station.bus import address as addresses
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.clock import Thread
from station.errors import BusError, NotReady
from station.life import supervisor_pipe
from station.life.event_publisher import EventPublisher
from station.life.events import Severity
from station.life.restarts import RESTARTS_VARIABLE, Restarts
from station.life.server import Health, State, decode_health

NAME = "supervisor"

_STACKS_S = 0.2  # writing them takes a millisecond, once the child is given a processor
_STOP_S = 15.0  # a command server blends for 2 s, a recorder closes its episode; then the child is killed
_HURRY_S = 5.0  # a blend and a flush to the disk still fit
_LOOK_S = 0.01
_NURSE_S = 0.05
_PROGRESS: dict[State, int] = {"unconfigured": 0, "inactive": 1, "active": 2}


class Child(msgspec.Struct):
    """One server process and our end of its pipe."""

    name: str
    process: subprocess.Popen[bytes]
    go: int
    log: Path
    started_s: float
    arguments: list[str]
    restarts: Restarts | None = None
    is_wanted: bool = True
    was_activated: bool = False


class Supervisor:
    """The children of one station.

    Args:
        bus: Where their health is read.
        folder: Where their logs go.
        environment: Variables that every child gets beside our own.
    """

    def __init__(self, bus: Bus, folder: Path, environment: Mapping[str, str] | None = None) -> None:
        self._bus, self.clock = bus, bus.clock
        self._folder = folder
        self._environment = dict(environment or {})
        self.children: dict[str, Child] = {}
        self.publisher = EventPublisher(bus, NAME)
        self._lock = self.clock.lock()  # around what is done to a child
        self._nurse: Thread | None = None
        self._closed = threading.Event()

    def spawn(self, name: str, config: msgspec.Struct, *, server: str = "", restarts: Restarts | None = None) -> None:
        """Start the process of a server; it loads and then waits to be activated.

        With `restarts`, a process that dies after it was active is started again, as often as those allow.
        """
        self._folder.mkdir(parents=True, exist_ok=True)
        log = self._folder / f"{name}.log"
        log.unlink(missing_ok=True)
        arguments = ["serve", server or name, "--name", name, "--config-json", _json(config)]
        process, go = self._launch(arguments, log, 0)
        with self._lock:
            self.children[name] = Child(name, process, go, log, self.clock.monotonic_s(), arguments, restarts)
        if restarts is not None and self._nurse is None:
            self._nurse = self.clock.start(self._restart_dead, "supervisor")

    def _launch(self, arguments: list[str], log: Path, restarts: int) -> tuple[subprocess.Popen[bytes], int]:
        reading, writing = os.pipe()
        os.set_inheritable(reading, True)
        with log.open("ab") as output:
            process = subprocess.Popen(
                python_child.command("-m", "station", *arguments),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                pass_fds=(reading,),
                env=self._child_environment(reading) | {RESTARTS_VARIABLE: str(restarts)},
                start_new_session=True,  # Ctrl-C in the terminal is ours to hear; the children stop in our order
            )
        os.close(reading)
        os.set_blocking(writing, False)  # a frozen child, which reads nothing, must not hold us
        return process, writing

    def wait_for(self, name: str, state: State, timeout_s: float, *, stop: threading.Event | None = None) -> Health:
        """Wait until a child says that it is in a state, or beyond.

        Raises:
            NotReady: it did not get there in time, or it or another child died, with its last words; or `stop` was
                set meanwhile.
        """
        deadline = self.clock.monotonic_s() + timeout_s
        child = self.children[name]
        while True:
            health = self.health(name)
            if health is not None and _PROGRESS.get(health.state, -1) >= _PROGRESS[state]:
                return health
            for dead, code in self.ended().items():
                doing = "starting" if self.children[dead].was_activated else "loading"
                waited = "" if dead == name else f" ({name!r} was waited for)"
                raise NotReady(f"server {dead!r} {how_it_ended(code)} while {doing}{waited}: {self.last_words(dead)}")
            if stop is not None and stop.is_set():
                raise NotReady(f"asked to stop before server {name!r} was {state}")
            if self.clock.monotonic_s() > deadline:
                seen, words = health.state if health else "unconfigured", self.last_words(name)
                where = " where it stands" if self._have_stacks_written(child) else ""
                raise NotReady(
                    f"server {name!r} is {seen}, not {state}, after {timeout_s:g} s: {words}; give it longer with "
                    f"ready_within, or see in its log {child.log}{where}"
                )
            self.clock.sleep(_LOOK_S)

    def activate(self, name: str) -> None:
        """Let a loaded child begin its work."""
        child = self.children[name]
        child.was_activated = True
        if child.restarts is not None:
            child.restarts.is_armed = True
        with contextlib.suppress(BrokenPipeError):  # it has just died; the next poll will say so
            os.write(child.go, b"go\n")

    def health(self, name: str) -> Health | None:
        """Return what a child last said of itself; None before its first word, and while the bus is away."""
        try:
            data = self._bus.get(keys.server(name))
        except BusError:  # its line is mended in the background; the waiting has a deadline
            return None
        health = decode_health(data) if data is not None else None
        return health if health is not None and health.pid == self.children[name].process.pid else None

    def ended(self) -> dict[str, int]:
        """Return the exit codes of the children that have ended, and are not to be started again."""
        with self._lock:
            codes = {name: child.process.poll() for name, child in self.children.items() if not self._may_return(child)}
        return {name: code for name, code in codes.items() if code is not None}

    @staticmethod
    def _may_return(child: Child) -> bool:
        code = child.process.poll()
        return child.restarts is not None and child.is_wanted and code is not None and child.restarts.allow(code)

    def _restart_dead(self) -> None:
        """Start again what died and may."""
        while not self.clock.wait(self._closed, _NURSE_S):
            with self._lock:
                for child in list(self.children.values()):
                    if child.restarts is not None and child.is_wanted:
                        self._check_child(child, child.restarts)

    def _check_child(self, child: Child, restarts: Restarts) -> None:
        code, now_s = child.process.poll(), self.clock.monotonic_s()
        if code is None:
            return
        if not restarts.has_noted(child.process.pid):
            restarts.record(child.process.pid, now_s - child.started_s)
            self._publish_exit(child, restarts, code)
            child.started_s = now_s
        if restarts.allow(code) and now_s - child.started_s >= restarts.delay_s:
            os.close(child.go)
            child.process, child.go = self._launch(child.arguments, child.log, restarts.count)
            child.started_s = now_s
            with contextlib.suppress(BrokenPipeError):
                os.write(child.go, b"go\n")

    def _publish_exit(self, child: Child, restarts: Restarts, code: int) -> None:
        """Publish what happened to a child, and what becomes of it."""
        how = how_it_ended(code)
        if restarts.allow(code):
            self.publish("server-restarted", "warning", server=child.name, reason=how, restarts=restarts.count,
                      delay_s=restarts.delay_s)  # fmt: skip
        else:
            self.publish("server-given-up", "error", server=child.name, reason=restarts.why(how))

    def publish(self, name: str, severity: Severity, **detail: Any) -> None:
        """Publish what happened to the servers as an event, so that it stands in the episode."""
        self.publisher.publish_unlogged(name, severity, **detail)

    def start_again(self, name: str) -> None:
        """Start a child once more, as it was configured, in place of one that died or is frozen.

        It becomes active as soon as it has loaded.
        """
        with self._lock:
            child = self.children[name]
            child.process.kill()
            child.process.wait()
            count = 1
            if child.restarts is not None:
                child.restarts.pardon()
                count = max(1, child.restarts.count)
            os.close(child.go)
            child.process, child.go = self._launch(child.arguments, child.log, count)
            child.started_s = self.clock.monotonic_s()
            with contextlib.suppress(BrokenPipeError):
                os.write(child.go, b"go\n")

    def estop(self) -> None:
        """Ask every child that drives a robot for the emergency stop, whatever the bus does."""
        with self._lock:
            for child in self.children.values():
                with contextlib.suppress(BrokenPipeError, BlockingIOError):  # dead, or frozen and told often enough
                    os.write(child.go, b"estop\n")

    def stop(self, name: str, timeout_s: float = _STOP_S) -> int:
        """Ask a child to finish, wait, kill it if it does not; return its exit code.

        Interrupted in its wait, it leaves the child to the next call.
        """
        child = self.children[name]
        with self._lock:
            child.is_wanted = False
        if child.process.poll() is None:
            child.process.terminate()
        try:
            code = child.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._have_stacks_written(child)
            child.process.kill()
            code = child.process.wait()
        with self._lock:
            del self.children[name]
            os.close(child.go)
        return code

    def stop_all(self) -> None:
        """Stop whatever still runs: all at once and soon, since there is no time for an order here."""
        deadline = self.clock.monotonic_s() + _HURRY_S
        self._closed.set()
        if self._nurse is not None:
            self.clock.join(self._nurse)
        try:
            for child in self.children.values():
                child.process.terminate()
            for name in reversed(list(self.children)):
                self.stop(name, max(0.0, deadline - self.clock.monotonic_s()))
        except KeyboardInterrupt:
            for child in self.children.values():
                child.process.kill()
            raise

    def last_words(self, name: str) -> str:
        """Return the last line that a child printed: its reason, when it ended by itself."""
        log = self.children[name].log
        lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
        return lines[-1].removeprefix("station: ") if lines else f"it printed nothing to {log}"

    def _have_stacks_written(self, child: Child) -> bool:
        """Have a child that does not do what it is asked for write to its log where each of its threads stands; return
        False for one that is too young to do so."""
        if not python_child.writes_stacks(child.process.pid):
            return False
        child.process.send_signal(python_child.STACKS)
        self.clock.sleep(_STACKS_S)
        return True

    def _child_environment(self, descriptor: int) -> dict[str, str]:
        return {
            **os.environ,
            **self._environment,
            # In the environment, not among the arguments: a password must not show in the process list.
            addresses.ENVIRONMENT_VARIABLE: self._bus.address.url,
            supervisor_pipe.ENVIRONMENT_VARIABLE: str(descriptor),
            "PYTHONUNBUFFERED": "1",
        }


def how_it_ended(code: int) -> str:
    """Return in words how a process ended whose exit code, or negative signal, is given."""
    if code >= 0:
        return f"ended with code {code}"
    try:
        return f"was killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"was killed by signal {-code}"


def _json(config: msgspec.Struct) -> str:
    return codec.json_object(configuration.to_plain(config)).decode()


def log_folder(address: BusAddress) -> Path:
    """Return the folder for the logs of the servers on a bus."""
    label = "".join(c if c.isalnum() else "-" for c in str(address)).strip("-")
    return addresses.runtime_folder() / "logs" / label[-60:]
