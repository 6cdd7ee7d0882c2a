"""Servers of a station on other machines: what it wants to run there, said twice a second, and what runs.

On each of these machines an agent runs (`station.supervision.agent`). A station says on ``station:host:<name>`` which
servers it wants there and how far each should be; the agent makes it so and tells in its heartbeat what has become of
them. Nothing is asked for once: what a line has lost is said again, and what is said twice is done once.
"""

from __future__ import annotations

import contextlib
import getpass
import os
import secrets
import socket
import subprocess
import threading
from collections.abc import Mapping
from typing import Any, Literal

import msgspec

from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.sample import Sample
from station.clock import Thread
from station.errors import BusError, NotReady, Refused, did_you_mean
from station.life.server import Health, decode_health, read_health

LEASE_S = 15.0
"""So long a station may be silent before its servers on other machines are let go, and finish [s]; a line that was cut
for 5 s has been heard of again by then."""

_SAY_S = 0.5
_SILENT_S = 2.0  # four heartbeats
_ANSWERS_S = 1.0
_LOOK_S = 0.02
_GONE = 1  # exit code of a server whose machine nothing is heard of
_AGENT = "host-"

Stage = Literal["load", "run", "end", "kill"]


class WantedServer(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A server that a station wants on a machine.

    Attributes:
        kind: Which one.
        config: Its configuration.
        agent: When the agent that shall run it was started itself, on its wall clock [ns]: no later one does so
            unasked.
        process: Counts its processes: another number wants another process.
        restarts: How often it was started again because it had died, or a person wanted it.
        stage: How far its process should be: loaded, active, asked to finish, ended.
    """

    kind: str
    config: dict[str, Any]
    agent: int
    process: int
    restarts: int = 0
    stage: Stage = "load"


class Wanted(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """All that a station wants on a machine.

    Attributes:
        station: Its id.
        who: User, machine and process, for people.
        servers: By name.
    """

    station: str
    who: str
    servers: dict[str, WantedServer]


class RunningServer(msgspec.Struct, frozen=True, kw_only=True):
    """What has become of a server that was wanted.

    Attributes:
        process: Which process of it this is, see `WantedServer`.
        pid: Its id; 0 where none could be started.
        code: Its exit code, or negative signal; None while it runs.
        last_words: The last line that it printed, once it has ended.
        log: File with all of them.
    """

    process: int
    pid: int = 0
    code: int | None = None
    last_words: str = ""
    log: str = ""


class HostFacts(msgspec.Struct, frozen=True, kw_only=True):
    """What the heartbeat of an agent says of its machine.

    Attributes:
        version: Of the station that is installed there.
        station, who: Whose servers it runs, see `Wanted`; "" for nobody's.
        servers: What has become of them, by name.
        data: Folder of episodes there.
        free_gb: What is free on its disk [GB].
    """

    version: str
    station: str = ""
    who: str = ""
    servers: dict[str, RunningServer] = {}
    data: str = ""
    free_gb: float = 0.0


def agent_name(host: str) -> str:
    """Return the name that the agent of a machine has among the servers."""
    return _AGENT + host


def host_of(agent: str) -> str:
    """Return the machine of which a server is the agent; "" of any other server."""
    return agent.removeprefix(_AGENT) if agent.startswith(_AGENT) else ""


def facts_of(health: Health) -> HostFacts | None:
    """Return what an agent says of its machine; None of what is no agent."""
    try:
        return msgspec.convert(health.detail, HostFacts) if host_of(health.name) else None
    except msgspec.ValidationError:
        return None


def joined(bus: Bus) -> dict[str, HostFacts]:
    """Return the machines that have joined a bus and are heard of, by name."""
    now_ns = bus.clock.wall_ns()
    alive = [health for health in read_health(bus) if health.is_alive_at(now_ns)]
    return {host_of(health.name): facts for health in alive if (facts := facts_of(health)) is not None}


class Hosts:
    """The servers of one station on other machines.

    Args:
        bus: The bus that the station and these machines share.
    """

    def __init__(self, bus: Bus) -> None:
        self._bus, self._clock = bus, bus.clock
        self._station = secrets.token_hex(6)
        self._hosts: dict[str, _Host] = {}
        self._line: Bus | None = None  # its own, on which nothing is asked: a cut of seconds loses nothing there
        self._lock = self._clock.lock()
        self._closed = threading.Event()
        self._thread: Thread | None = None

    def expect(self, host: str) -> HostFacts:
        """Return what a machine says of itself.

        Raises:
            NotReady: it has not joined.
            Refused: it runs servers of another station.
        """
        found = joined(self._bus)
        if host not in found:
            raise NotReady(
                f"host {host!r}{did_you_mean(host, found)} has not joined {self._bus.address}: there, run "
                f"`station host join --name {host}`; joined: {', '.join(found) or 'none'}"
            )
        facts = found[host]
        if facts.station not in ("", self._station):
            raise Refused(f"host {host!r} runs servers for the station of {facts.who}; end that one first")
        return facts

    def launch(self, host: str, name: str, kind: str, config: Mapping[str, Any], restarts: int = 0) -> RemoteProcess:
        """Have a server started on a machine that has joined.

        Args:
            host: The machine.
            name: Name of the server on the bus.
            kind: Which one.
            config: Its configuration.
            restarts: As of `WantedServer`.
        """
        with self._lock:
            if self._line is None:
                self._line = Bus(self._bus.address, name="hosts", timeout_s=_ANSWERS_S)
            if host not in self._hosts:
                self._hosts[host] = _Host(self._bus, self._line, host, self._station)
            if self._thread is None:
                self._thread = self._clock.start(self._say, "hosts")
        return self._hosts[host].launch(name, kind, config, restarts)

    def close(self) -> None:
        """Say that nothing is wanted any more: what still runs finishes."""
        self._closed.set()
        if self._thread is not None:
            self._clock.join(self._thread)
        for host in self._hosts.values():
            host.close()
        self._hosts.clear()
        if self._line is not None:
            self._line.close()
            self._line = None

    def _say(self) -> None:
        while not self._clock.wait(self._closed, _SAY_S):
            with self._lock:
                hosts = list(self._hosts.values())
            for host in hosts:
                host.say()


class _Host:
    """What is wanted of one machine, and what it says."""

    def __init__(self, bus: Bus, line: Bus, name: str, station: str) -> None:
        self.name, self.clock = name, bus.clock
        self._bus, self._line, self._station = bus, line, station
        self._who = f"{getpass.getuser()} on {socket.gethostname()} (pid {os.getpid()})"
        self._agent = keys.server(agent_name(name))
        self._watch = bus.watch([self._agent])
        self._wanted: dict[str, WantedServer] = {}
        self._processes = 0
        self._lock = self.clock.lock()
        self._sample: Sample | None = None
        self._health: Health | None = None
        self._facts: HostFacts | None = None
        self._heard_s = self.clock.monotonic_s()
        self._take(bus.get(self._agent) or b"")

    def launch(self, name: str, kind: str, config: Mapping[str, Any], restarts: int) -> RemoteProcess:
        self._look()
        agent = 0 if self._health is None else self._health.started_wall_ns
        with self._lock:
            self._processes += 1
            number = self._processes
            self._wanted[name] = WantedServer(
                kind=kind, config=dict(config), agent=agent, process=number, restarts=restarts
            )
        self.say()
        return RemoteProcess(self, name, number, agent)

    def want(self, name: str, process: int, stage: Stage | None) -> None:
        """Have a process elsewhere from now on; None wants it no more."""
        with self._lock:
            if (wanted := self._wanted.get(name)) is None or wanted.process != process:
                return
            if stage is None:
                del self._wanted[name]
            else:
                self._wanted[name] = msgspec.structs.replace(wanted, stage=stage)
        self.say()

    def say(self) -> None:
        with self._lock:
            wanted = Wanted(station=self._station, who=self._who, servers=dict(self._wanted))
        self._line.publish({keys.host(self.name): codec.json_object(wanted)})

    def running(self, name: str, process: int) -> RunningServer | None:
        """Return what the machine says of a process; None while it says nothing of it."""
        self._look()
        if self._facts is None or self._facts.station != self._station:
            return None
        found = self._facts.servers.get(name)
        return found if found is not None and found.process == process else None

    def why_gone(self, agent: int, name: str, pid: int) -> str:
        """Return why a process ended of which its agent says nothing, or "" where it may run.

        Args:
            agent: As of `WantedServer`.
            name, pid: Of the server, and its process there.
        """
        self._look()
        silent_s = self.clock.monotonic_s() - self._heard_s
        if "NOPERM" in self._line.last_error:
            return f"the bus takes {keys.host(self.name)} of user 'operator' alone ({self._line.last_error})"
        if self._health is not None and self._health.state == "finalized":
            return f"the agent of host {self.name!r} has ended ({self._health.reason}), and its servers with it"
        if self._health is not None and self._health.started_wall_ns != agent:
            return f"the agent of host {self.name!r} was started anew, and its servers have ended"
        if silent_s > _SILENT_S and self._said_farewell(name, pid):
            return f"finished by itself, as the agent of host {self.name!r} says nothing any more"
        if silent_s > LEASE_S:
            return f"nothing was heard of host {self.name!r} for {LEASE_S:g} s; servers that run there finish"
        return ""

    def _said_farewell(self, name: str, pid: int) -> bool:
        with contextlib.suppress(BusError):
            health = decode_health(self._bus.get(keys.server(name)) or b"")
            return health is not None and (health.pid, health.state) == (pid, "finalized")
        return False

    def whose(self) -> str:
        """Return why a process may not have been started: the machine serves another station, or says nothing."""
        if self._facts is not None and self._facts.station not in ("", self._station):
            return f"host {self.name!r} runs servers for the station of {self._facts.who}"
        return f"host {self.name!r} has not said yet that it runs"

    def close(self) -> None:
        self._wanted.clear()
        self.say()
        self._watch.close()

    def _look(self) -> None:
        sample = self._watch.latest(self._agent)
        if sample is None or sample is self._sample:
            return
        self._sample, self._heard_s = sample, self.clock.monotonic_s()
        self._take(sample.value)

    def _take(self, said: bytes) -> None:
        health = decode_health(said)
        facts = None if health is None else facts_of(health)
        if facts is not None:
            self._health, self._facts = health, facts


class RemoteProcess:
    """One process on another machine; see `station.supervision.process.Process`.

    Args:
        host: The machine.
        name: Of the server.
        number: Of the process.
        agent: When the agent that starts it was started itself, see `WantedServer`.
    """

    def __init__(self, host: _Host, name: str, number: int, agent: int) -> None:
        self._host, self._name, self._number, self._agent = host, name, number, agent
        self._last: RunningServer | None = None
        self._why_gone = ""

    @property
    def pid(self) -> int:
        """As `Process.pid`."""
        found = self._look()
        return 0 if found is None else found.pid

    @property
    def log(self) -> str:
        """As `Process.log`."""
        found = self._look()
        return f"{found.log if found else 'that'} on host {self._host.name!r} (`station logs {self._name}` shows it)"

    def poll(self) -> int | None:
        """As `Process.poll`; 1 also where its machine is gone."""
        found = self._look()
        if found is not None and found.code is not None:
            return found.code
        self._why_gone = self._why_gone or self._host.why_gone(
            self._agent, self._name, 0 if found is None else found.pid
        )
        return _GONE if self._why_gone else None

    def wait(self, timeout_s: float | None = None) -> int:
        """As `Process.wait`."""
        clock = self._host.clock
        began_s = clock.monotonic_s()
        while (code := self.poll()) is None:
            if timeout_s is not None and clock.monotonic_s() - began_s > timeout_s:
                raise subprocess.TimeoutExpired(self._name, timeout_s)
            clock.sleep(_LOOK_S)
        return code

    def go(self) -> None:
        """As `Process.go`."""
        self._host.want(self._name, self._number, "run")

    def estop(self, reason: str) -> bool:
        """As `Process.estop`: the bus is the only line to it; there, `station estop` asks its machine's agent."""
        return False

    def terminate(self) -> None:
        """As `Process.terminate`."""
        self._host.want(self._name, self._number, "end")

    def kill(self) -> None:
        """As `Process.kill`; where each of its threads stands is in its log then."""
        self._host.want(self._name, self._number, "kill")

    def write_stacks(self) -> bool:
        """As `Process.write_stacks`: only on the way to its end."""
        return False

    def last_words(self) -> str:
        """As `Process.last_words`."""
        found = self._look()
        if found is not None and found.code is not None:
            return found.last_words
        return self._why_gone or (self._host.whose() if found is None else f"see its log {self.log}")

    def close(self) -> None:
        """As `Process.close`."""
        self._host.want(self._name, self._number, None)

    def _look(self) -> RunningServer | None:
        if self._last is None or self._last.code is None:
            self._last = self._host.running(self._name, self._number) or self._last
        return self._last
