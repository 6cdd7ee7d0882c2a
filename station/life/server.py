"""A server's life: unconfigured, inactive, active, finalized.

What a server registers (`ServerKind`), what it says of itself on the bus (`Health`), and what its main gets of the
station (`Life`): heartbeat, events, the supervisor's pipe. `station.life.serving` runs one.
"""

from __future__ import annotations

import logging
import os
import socket
import threading
from collections.abc import Callable
from typing import Any, Literal, ParamSpec

import msgspec

from station.bus import clocks, codec, keys, stamp
from station.bus.client import Bus
from station.clock import SYSTEM
from station.errors import BusError
from station.life import supervisor_pipe
from station.life.event_publisher import EventPublisher
from station.life.events import Event, Severity

log = logging.getLogger(__name__)

P = ParamSpec("P")
State = Literal["unconfigured", "inactive", "active", "finalized"]
Role = Literal["command", "low-level", "recorder", "sensor", "observer", "console"]

HEARTBEAT_S = 0.5
DEAD_AFTER_S = 2.0  # four heartbeats


class ServerKind(msgspec.Struct, frozen=True, kw_only=True):
    """What a module in `servers` registers.

    Attributes:
        name: Name under which it is started.
        role: What it is to a station.
        summary: What it does, in a line.
        config: Type of its configuration.
        main: Runs it until it is asked to stop; returns an exit code. Imports what is heavy only when called.
        expect: Raises a `station.errors.StationError` where something that a configuration names is not on this
            machine, such as a file or a library; called before anything starts. None for nothing to look for.
        bus_timeout_s: Longest wait for an answer of the bus while it runs [s]; longer for one that moves nothing, and
            would rather wait for a bus that is busy (with the picture that it takes for a new recorder, say) than end.
        loads_first: Whether what a runbook starts after it loads once it is active, and not beside it: a robot's server
            waits for the robot's first state while it loads, and from a twin none comes before that.
    """

    name: str
    role: Role
    summary: str
    config: type[msgspec.Struct]
    main: Callable[[Any, Life], int]
    expect: Callable[[Any], object] | None = None
    bus_timeout_s: float = 0.05
    loads_first: bool = False


_LEAST = 0.9  # of its nominal rate: a loop that has less is late


class Health(msgspec.Struct, kw_only=True):
    """What a server says of itself on ``station:server:<name>``, twice a second and at each change of state.

    `events` are those of the last few seconds, which on their own key may have been overwritten before anybody looked.
    `rate_hz` and `nominal_hz` are the ticks per second that its loop has, and is to have.
    """

    name: str
    role: Role
    state: State
    pid: int
    host: str
    boot: str
    source: str
    started_wall_ns: int
    wall_ns: int
    reason: str = ""
    config_sha256: str = ""
    rate_hz: float | None = None
    nominal_hz: float | None = None
    jitter_p50_ms: float | None = None
    jitter_p99_ms: float | None = None
    overruns: int = 0
    lost_writes: int = 0
    detail: dict[str, Any] = {}
    events: list[Event] = []

    @property
    def is_alive(self) -> bool:
        """Whether it is alive now, by this machine's clock."""
        return self.is_alive_at(SYSTEM.wall_ns())

    def is_alive_at(self, wall_ns: int) -> bool:
        """Whether its last word is fresh and no farewell, by the wall clock of who read it (`read_health`)."""
        is_fresh = wall_ns - self.wall_ns < DEAD_AFTER_S * 1e9
        return self.state != "finalized" and is_fresh and not self._is_dead_process()

    @property
    def why_late(self) -> str:
        """Why its loop has less than nine tenths of its nominal rate, or "" where it has more, or no loop."""
        if not self.rate_hz or not self.nominal_hz or not self.rate_hz < _LEAST * self.nominal_hz:
            return ""
        return "its loop does not keep its rate: its machine is too slow for what runs there, or busy"

    def _is_dead_process(self) -> bool:
        """Whether it was killed on this machine: its last heartbeat may still look fresh."""
        if (self.boot, self.host) != (stamp.boot_id(), socket.gethostname()):
            return False
        try:
            os.kill(self.pid, 0)
        except (ProcessLookupError, OverflowError):  # a number that no process has
            return True
        except PermissionError:  # it lives, as another user
            return False
        return False


_HEALTH_FIELDS = ("rate_hz", "nominal_hz", "jitter_p50_ms", "jitter_p99_ms", "overruns")


class Life:
    """What a server's main needs of the station it lives in.

    Attributes:
        clock: Whoever waits, or asks what time it is, does it by this one.
        failure: What ends the server, of another thread than that of its main.
    """

    def __init__(self, kind: ServerKind, name: str, bus: Bus, config_sha256: str) -> None:
        self.name = name
        self._kind = kind
        self.bus, self.clock = bus, bus.clock
        self.stop_event = threading.Event()
        self.failure: Exception | None = None
        self._supervisor_pipe = supervisor_pipe.from_environment(self.stop_event.set)
        self._configuration: bytes | None = None
        self._publisher = EventPublisher(bus, name)
        self._on_bus_back: Callable[[], None] = lambda: None
        self._ended = threading.Event()
        now_ns = self.clock.wall_ns()
        self._health = Health(
            name=name, role=kind.role, state="unconfigured", pid=os.getpid(), host=socket.gethostname(),
            boot=stamp.boot_id(), source=bus.source, started_wall_ns=now_ns, wall_ns=now_ns,
            config_sha256=config_sha256,
        )  # fmt: skip
        self.publish()
        bus.clocks.publish = bus.publish
        if not bus.address.is_local:
            bus.clocks.start()  # so that our commands have an age where the robot is
        self._heart = self.clock.start(self._beat, "heartbeat")

    @property
    def started_wall_ns(self) -> int:
        """When it was started, on the wall clock [ns]."""
        return self._health.started_wall_ns

    @property
    def stopping(self) -> bool:
        """Whether the server has been asked to finish."""
        return self.stop_event.is_set()

    def configured(self, facts: dict[str, Any]) -> None:
        """State on the bus what this server runs, and its kind; no recording begins before all low-level ones have."""
        self._configuration = codec.json_object({"kind": self._kind.name, **facts})
        self.bus.publish({keys.server_config(self.name): self._configuration})

    def ready(self) -> bool:
        """Publish that all is loaded, wait for the supervisor's "go" (at once without one), and become active.

        Returns:
            False when the server was asked to stop instead.
        """
        self._become("inactive")
        if self._supervisor_pipe is not None:
            while not self.clock.wait(self._supervisor_pipe.activated, 0.05) and not self.stopping:
                pass
        if self.stopping:
            return False
        self.bus.set_timeout(self._kind.bus_timeout_s)
        self._become("active")
        if self._supervisor_pipe is None:  # a supervisor says so itself
            log.info("%s is active on %s; Ctrl-C ends it", self.name, self.bus.address)
        return True

    def on_estop(self, act: Callable[[str], None]) -> None:
        """Have something called with the reason, in another thread, when the supervisor asks for the emergency stop."""
        if self._supervisor_pipe is not None:
            self._supervisor_pipe.on_estop = act

    def on_bus_back(self, act: Callable[[], None]) -> None:
        """Have something called, in another thread, when the bus is back and may have forgotten everything.

        Where it raises `BusError` it is called again, half a second later.
        """
        self._on_bus_back = act

    def event(self, name: str, *, severity: Severity = "info", **detail: Any) -> None:
        """Publish an event: on the bus, so that it stands in the episode, and in the log."""
        self._publisher.publish(name, severity, **detail)

    def guarded(self, act: Callable[P, None]) -> Callable[P, None]:
        """Return what another thread may call: where it raises, the server ends with that error."""

        def guard(*arguments: P.args, **named: P.kwargs) -> None:
            try:
                act(*arguments, **named)
            except Exception as error:  # noqa: BLE001  # raised again by who runs the server
                self.failure = self.failure or error
                self.stop_event.set()

        return guard

    def last_word(self, name: str, **detail: Any) -> None:
        """Publish what ends this server; its starter prints the error itself."""
        self._publisher.publish_unlogged(name, "error", **detail)

    def report(self, **facts: Any) -> None:
        """Set what the next heartbeat says of the server: rate_hz, jitter_p50_ms, … or anything of its own."""
        for name, value in facts.items():
            if name in _HEALTH_FIELDS:
                setattr(self._health, name, value)
            else:
                self._health.detail[name] = value

    def end(self, reason: str) -> None:
        """Publish the farewell and stop the heartbeat."""
        self._ended.set()
        self.clock.join(self._heart)
        self._health.reason = reason
        self._become("finalized")

    def _become(self, state: State) -> None:
        self._health.state = state
        self.publish()

    def _beat(self) -> None:
        connections = self.bus.connections
        while not self.clock.wait(self._ended, HEARTBEAT_S):
            self.publish()
            if (now := self.bus.connections) != connections and self._publish_again():
                connections = now
            for outage in self.bus.outages.pop():
                self.event(outage.kind, severity="warning", **outage.detail(self.clock.monotonic_ns()))
                self._publisher.publish_late()

    def _publish_again(self) -> bool:
        """Publish what a restarted bus has forgotten; return whether the bus took it."""
        if self._configuration is not None:
            self.bus.publish({keys.server_config(self.name): self._configuration})
        try:
            self._on_bus_back()
        except BusError as error:
            log.info("to be said again: %s", error)
            return False
        return True

    def publish(self) -> None:
        """Say at once how the server is doing, beside what its heartbeat says anyway."""
        self._health.wall_ns = self.clock.wall_ns()
        self._health.lost_writes = self.bus.lost_writes
        self._health.events = self._publisher.recent
        self.bus.publish({keys.server(self.name): codec.json_object(self._health)})


def read_health(bus: Bus) -> list[Health]:
    """Return what every server that ever spoke on this bus last said, by name; when, by this machine's wall clock."""
    names = bus.names(keys.SERVER_PREFIX + "*")
    found = [health for sample in bus.read(names).values() if (health := decode_health(sample.value)) is not None]
    elsewhere = {health.boot for health in found} - {stamp.boot_id()}
    ahead_ns = clocks.walls_ahead_ns(bus.call, elsewhere, bus.clock)
    for health in found:
        health.wall_ns -= ahead_ns.get(health.boot, 0)
    return sorted(found, key=lambda health: health.name)


def read_configurations(bus: Bus) -> list[dict[str, Any]]:
    """Return what servers state that they run; what is no JSON object states nothing."""
    names = bus.names(keys.CONFIG_PREFIX + "*")
    return [codec.parse_facts(sample.value) for sample in bus.read(names).values()]


def decode_health(data: bytes) -> Health | None:
    """Return the health that bytes from the bus hold, or None when they hold none."""
    try:
        return codec.parse_struct(data, Health)
    except codec.BadValue as error:
        log.debug("not a server's health: %s", error)
        return None
