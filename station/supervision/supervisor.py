"""Starts servers as child processes, activates them in order, and never leaves one behind.

A child loads everything and then waits, inactive, for "go" on its pipe (`station.life.supervisor_pipe`); so the slow
part of a start runs in parallel and the order of a runbook still holds. A child that dies takes nothing silently with
it: its last words are kept. A recorder that dies is started again (`station.life.restarts`), since its episode waits
for it; whatever moves a robot is not, unless a runbook or a person says so (`station.supervision.exit_policy`). When
the supervisor itself is killed, every pipe breaks and the children finish by themselves.
"""

from __future__ import annotations

import signal
import subprocess
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from station import config as configuration
from station import registry
from station.bus import address as addresses
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.clock import Thread
from station.errors import BusError, NotReady
from station.life.event_publisher import EventPublisher
from station.life.events import Severity
from station.life.restarts import Restarts
from station.life.server import Health, State, decode_health
from station.life.stop_line import StopReply
from station.supervision.hosts import Hosts
from station.supervision.process import LocalProcess, Process

NAME = "supervisor"

_DRIVES = "low-level"  # the role of what drives a robot

_STOP_S = 15.0  # a command server blends for 2 s, a recorder closes its episode; then the child is killed
_HURRY_S = 5.0  # a blend and a flush to the disk still fit
_LOOK_S = 0.01
_NURSE_S = 0.05
_PROGRESS: dict[State, int] = {"unconfigured": 0, "inactive": 1, "active": 2}


class Child(msgspec.Struct):
    """One server and its process; `host` is the machine that it runs on, "" for this one."""

    name: str
    kind: str
    config: msgspec.Struct
    host: str
    process: Process
    started_s: float
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
        self.hosts = Hosts(bus)
        self.children: dict[str, Child] = {}
        self.publisher = EventPublisher(bus, NAME)
        self._lock = self.clock.lock()  # around what is done to a child
        self._nurse: Thread | None = None
        self._closed = threading.Event()

    def spawn(
        self,
        name: str,
        config: msgspec.Struct,
        *,
        server: str = "",
        host: str = "",
        restarts: Restarts | None = None,
    ) -> None:
        """Start the process of a server; it loads and then waits to be activated.

        Args:
            name: Its name on the bus.
            config: Its configuration.
            server: Its kind, by default that of its name.
            host: The machine that it runs on, one that has joined (`station.supervision.agent`); "" for this one.
            restarts: A process that dies after it was active is started again, as often as these allow.
        """
        kind = server or name
        process = self._launch(name, kind, config, host, 0)
        with self._lock:
            self.children[name] = Child(name, kind, config, host, process, self.clock.monotonic_s(), restarts)
        if restarts is not None and self._nurse is None:
            self._nurse = self.clock.start(self._restart_dead, "supervisor")

    def _launch(self, name: str, kind: str, config: msgspec.Struct, host: str, restarts: int) -> Process:
        """Start a process; the log of a server's first one begins anew."""
        plain = configuration.to_plain(config)
        if host:
            return self.hosts.launch(host, name, kind, plain, restarts)
        log = log_file(self._folder, name, is_new=restarts == 0)
        arguments = ["serve", kind, "--name", name, "--config-json", codec.json_object(plain).decode()]
        return LocalProcess(arguments, log, self._bus.address, self._environment, self.clock, restarts)

    def _launch_again(self, child: Child, restarts: int) -> None:
        child.process.close()
        child.process = self._launch(child.name, child.kind, child.config, child.host, restarts)
        child.started_s = self.clock.monotonic_s()
        child.process.go()

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
                where = " where it stands" if child.process.write_stacks() else ""
                raise NotReady(
                    f"server {name!r} is {seen}, not {state}, after {timeout_s:g} s: {words}; give it longer with "
                    f"ready_within, or see in its log {child.process.log}{where}"
                )
            self.clock.sleep(_LOOK_S)

    def activate(self, name: str) -> None:
        """Let a loaded child begin its work."""
        child = self.children[name]
        child.was_activated = True
        if child.restarts is not None:
            child.restarts.is_armed = True
        child.process.go()

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
            self._launch_again(child, restarts.count)

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
            self._launch_again(child, count)

    def estop(self, reason: str) -> StopReply:
        """Ask every child of this machine that drives a robot for the emergency stop, whatever the bus does.

        It does not wait for what else is done to a child, which may wait for the bus.
        """
        return stop_all_directly({child.name: (child.kind, child.process) for child in list(self.children.values())},
                                 reason)  # fmt: skip

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
            child.process.write_stacks()
            child.process.kill()
            code = child.process.wait()
        with self._lock:
            del self.children[name]
            child.process.close()
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
        finally:
            self.hosts.close()

    def last_words(self, name: str) -> str:
        """Return the last line that a child printed: its reason, when it ended by itself."""
        return self.children[name].process.last_words()


def stop_all_directly(processes: Mapping[str, tuple[str, Process]], reason: str) -> StopReply:
    """Ask every process for the emergency stop past the bus; tell what came of it where it drives a robot.

    Args:
        processes: Kind and process of servers, by name.
        reason: Who asks for it, and why.
    """
    told = {name: process.estop(reason) for name, (_, process) in processes.items()}
    robots = [name for name, (kind, _) in processes.items() if registry.find("server", kind).role == _DRIVES]
    return StopReply(
        told=tuple(name for name in robots if told[name]), not_told=tuple(name for name in robots if not told[name])
    )


def how_it_ended(code: int) -> str:
    """Return in words how a process ended whose exit code, or negative signal, is given."""
    if code >= 0:
        return f"ended with code {code}"
    try:
        return f"was killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"was killed by signal {-code}"


def log_file(folder: Path, name: str, *, is_new: bool) -> Path:
    """Return the file for the log of a server, its folder made; a new one begins empty."""
    folder.mkdir(parents=True, exist_ok=True)
    log = folder / f"{name}.log"
    if is_new:
        log.unlink(missing_ok=True)
    return log


def log_folder(address: BusAddress) -> Path:
    """Return the folder for the logs of the servers on a bus."""
    label = "".join(c if c.isalnum() else "-" for c in str(address)).strip("-")
    return addresses.runtime_folder() / "logs" / label[-60:]
