"""The agent of a machine: starts the servers that a station wants there, tells how they are, and lets none outlive it.

A person starts it (`station host join`), and it ends with Ctrl-C. What a station says (`station.supervision.hosts`) are
kinds of servers and their settings, never a command line. The servers are the agent's children: those of an agent
that is killed finish by themselves; so do those of a station that is silent for `hosts.LEASE_S`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from pathlib import Path

import msgspec

from station import registry
from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.protection import REMEDY, inspect
from station.episode.storage.folder import data_folder
from station.errors import ConfigError, Refused, StationError
from station.life.request import parse
from station.life.server import Life, ServerKind
from station.life.stop_line import StopLine, StopReply
from station.software import software
from station.supervision import hosts
from station.supervision.checks import free_gb
from station.supervision.hosts import HostFacts, RunningServer, Stage, Wanted, WantedServer
from station.supervision.log_tail import LogTail
from station.supervision.process import LocalProcess
from station.supervision.runbook import SERVER_NAME
from station.supervision.supervisor import log_file, log_folder, stop_all_directly

_LOOK_S = 0.1
_SAY_S = 0.5
_FINISH_S = 15.0  # as long as a station gives its servers
_MOST_LINES = 50
_LONGEST_LINE = 500
_REFUSED = 2  # exit code of what would be refused the same way again


class AgentConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of an agent.

    Attributes:
        host: What the machine is called in runbooks.
        allow: Kinds of servers that may be started here; none for all that are installed.
    """

    host: str
    allow: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse a name that no runbook may have, and a kind that is not installed."""
        if not SERVER_NAME.fullmatch(self.host):
            raise ValueError(f"expected a name of letters, digits, - and _, got {self.host!r}")
        for kind in self.allow:
            registry.find("server", kind)


class HostLog(msgspec.Struct, frozen=True, kw_only=True):
    """The newest lines that a server printed.

    Attributes:
        process: Of which process, see `WantedServer`.
        first: Number of the first of them, from 0.
        lines: They.
        wall_ns: When the last of them was found [ns].
    """

    process: int
    first: int
    lines: list[str]
    wall_ns: int


class _Running:
    """A process that was wanted."""

    def __init__(self, wanted: WantedServer, log: Path) -> None:
        self.kind, self.number, self.log = wanted.kind, wanted.process, log
        self.process: LocalProcess | None = None
        self.refused = ""
        self.stage: Stage = "load"
        self.tail, self.lines, self.printed = LogTail(log), deque[str](maxlen=_MOST_LINES), 0
        self._ended: RunningServer | None = None

    def said(self) -> RunningServer:
        if self.process is None:
            return RunningServer(process=self.number, code=_REFUSED, last_words=self.refused)
        found = RunningServer(process=self.number, pid=self.process.pid, code=self.process.poll(), log=str(self.log))
        if self._ended is None and found.code is not None:
            self._ended = msgspec.structs.replace(found, last_words=self.process.last_words())
        return self._ended or found


class Agent:
    """Runs what is wanted on one machine.

    Args:
        config: Its settings.
        life: Its own.
    """

    def __init__(self, config: AgentConfig, life: Life) -> None:
        self._config, self._life = config, life
        self._bus, self._clock = life.bus, life.clock
        self._folder = log_folder(life.bus.address)
        self._data = data_folder(None)
        self._running: dict[str, _Running] = {}
        self._station = self._who = ""
        self._heard_s, self._is_let_go = 0.0, False
        self._told: HostFacts | None = None
        self._refused = ""

    def run(self) -> int:
        """Do so until asked to stop; return the exit code."""
        key = keys.host(self._config.host)
        self._bus.clocks.start()  # so that a recorder elsewhere has this machine's clock, whoever commands its robot
        try:
            with self._bus.watch([key]) as watch, StopLine(self._bus.address, self._stop_directly):
                seen = watch.latest(key)  # what stood there before: whoever wanted it may be gone
                self._tell()
                if not self._life.ready():
                    return 0
                said_s = self._clock.monotonic_s()
                while not self._life.stopping:
                    sample = watch.wait(key, after=seen, timeout_s=_LOOK_S)
                    if sample is not None and sample is not seen:
                        seen = sample
                        if sample.arrived_ns is not None:  # else found after a cut, of whatever age
                            self._hear(sample.value)
                    self._look_at_lease()
                    self._tell()
                    if (now_s := self._clock.monotonic_s()) - said_s > _SAY_S:
                        said_s = now_s
                        for name, running in self._running.items():
                            self._publish_log(name, running)
            return 0
        finally:
            self._finish()

    def _stop_directly(self, reason: str) -> StopReply:
        """Stop the robots of this machine, whatever the bus does."""
        running = [(name, each.kind, each.process) for name, each in list(self._running.items())]
        return stop_all_directly({name: (kind, process) for name, kind, process in running if process}, reason)

    def _hear(self, data: bytes) -> None:
        """Take what a station wants; say once what is no such thing."""
        try:
            wanted = parse(data, Wanted, "what a station wants")
        except Refused as error:
            self._refuse(str(error))
            return
        if self._station not in ("", wanted.station):
            if not wanted.servers:
                return
            if not self._is_let_go:
                self._refuse(f"{wanted.who} wants servers here, while those of {self._who} run")
                return
            self._station = ""
            for name in list(self._running):
                self._drop(name)
        if not self._station and wanted.servers:
            self._station, self._who = wanted.station, wanted.who
            self._life.event("host-serves", who=self._who)
        self._heard_s, self._is_let_go = self._clock.monotonic_s(), False
        for name in [name for name in self._running if name not in wanted.servers]:
            self._drop(name)
        for name, server in wanted.servers.items():
            if server.agent == self._life.started_wall_ns:  # an earlier agent's has ended, and does not start by itself
                self._make_so(name, server)
        if not wanted.servers:
            self._station = self._who = ""

    def _refuse(self, reason: str) -> None:
        if reason != self._refused:
            self._refused = reason
            self._life.event("host-refused", severity="warning", reason=reason)

    def _make_so(self, name: str, wanted: WantedServer) -> None:
        known = self._running.get(name)
        if known is None or known.number != wanted.process:
            if known is not None:
                self._drop(name, at_once=True)
            known = self._running[name] = self._start(name, wanted)
        process, before, known.stage = known.process, known.stage, wanted.stage
        if process is None or before == wanted.stage or process.poll() is not None:
            return
        if wanted.stage == "run":
            process.go()
        elif wanted.stage == "end":
            process.terminate()
        elif wanted.stage == "kill":
            process.write_stacks()
            process.kill()
            process.wait()

    def _start(self, name: str, wanted: WantedServer) -> _Running:
        if not SERVER_NAME.fullmatch(name):  # it becomes the name of a file
            running = _Running(wanted, self._folder)
            running.refused = f"expected a name of letters, digits, - and _, got {name!r}"
            return running
        running = _Running(wanted, self._folder / f"{name}.log")
        try:
            kind: ServerKind = registry.find("server", wanted.kind)
            if self._config.allow and kind.name not in self._config.allow:
                allowed = ", ".join(self._config.allow)
                raise ConfigError(f"host {self._config.host!r} may start {allowed} alone (--allow), not {kind.name}")
            log = log_file(self._folder, name, is_new=wanted.restarts == 0)
            config = codec.json_object(wanted.config).decode()
            arguments = ["serve", kind.name, "--name", name, "--config-json", config, "--expect"]
            running.process = LocalProcess(arguments, log, self._bus.address, {}, self._clock, wanted.restarts)
        except (StationError, OSError) as error:  # the second of a full disk, or of too many processes
            running.refused = str(error)
        return running

    def _drop(self, name: str, *, at_once: bool = False) -> None:
        """Forget a server, which finishes if it still runs; `at_once` kills it."""
        running = self._running.pop(name)
        self._publish_log(name, running)
        if running.process is None:
            return
        if at_once and running.process.poll() is None:
            running.process.kill()
            running.process.wait()
        running.process.close()

    def _look_at_lease(self) -> None:
        """Let go the servers of a station that says nothing any more; it hears that they ended, should it come back."""
        if not self._station or self._is_let_go or self._clock.monotonic_s() - self._heard_s <= hosts.LEASE_S:
            return
        self._is_let_go = True
        names = ", ".join(sorted(self._running))
        self._life.event("host-let-go", severity="error", who=self._who, servers=names, silent_s=hosts.LEASE_S)
        for running in self._running.values():
            if running.process is not None:
                running.process.close()

    def _tell(self) -> None:
        """Say what runs, at once where that is news."""
        facts = HostFacts(
            version=software().version,
            station="" if self._is_let_go else self._station,
            who="" if self._is_let_go else self._who,
            servers={name: running.said() for name, running in self._running.items()},
            data=str(self._data.absolute()),
            free_gb=round(free_gb(self._data), 1),
        )
        if facts != self._told:
            self._told = facts
            self._life.report(**msgspec.to_builtins(facts))
            self._life.publish()

    def _publish_log(self, name: str, running: _Running) -> None:
        """Say what a server has printed since it was said last."""
        if running.process is None or not (lines := running.tail.read()):
            return
        running.lines.extend(line[:_LONGEST_LINE] for line in lines)
        running.printed += len(lines)
        first = running.printed - len(running.lines)
        log = HostLog(process=running.number, first=first, lines=list(running.lines), wall_ns=self._clock.wall_ns())
        self._bus.publish({keys.log(name): codec.json_object(log)})

    def _finish(self) -> None:
        """End what runs: all at once, since there is no time for an order here."""
        processes = [running.process for running in self._running.values() if running.process is not None]
        for process in processes:
            if process.poll() is None:
                process.terminate()
        end_s = self._clock.monotonic_s() + _FINISH_S
        while any(process.poll() is None for process in processes) and self._clock.monotonic_s() < end_s:
            self._clock.sleep(_LOOK_S)
        for process in processes:
            process.kill()
            process.wait()
        self._tell()
        for name in list(self._running):
            self._drop(name)


def _main(config: AgentConfig, life: Life) -> int:
    found = inspect(life.bus)
    if found.verdict == "open":
        raise ConfigError(f"bus {life.bus.address}: {found.found}, and so could start servers here; {REMEDY}")
    life.configured({"host": config.host, "version": software().version, "allow": list(config.allow)})
    return Agent(config, life).run()


KIND = ServerKind(
    name="host",
    role="observer",
    summary="Starts servers on this machine for a station on another one.",
    config=AgentConfig,
    main=_main,
    bus_timeout_s=1.0,
)


def read_logs(bus: Bus) -> Mapping[str, HostLog]:
    """Return the newest lines of servers that agents have started, by name; what is no such log has none."""
    found = {}
    for key, sample in bus.read(bus.names(keys.log("*"))).items():
        if (log := decode_log(sample.value)) is not None:
            found[key.removeprefix(keys.LOG_PREFIX)] = log
    return found


def decode_log(data: bytes) -> HostLog | None:
    """Return the lines that bytes from the bus hold, or None when they hold none."""
    try:
        return codec.parse_struct(data, HostLog)
    except codec.BadValue:
        return None


class HostTail:
    """Reads what an agent says of a server's log as it grows, as `LogTail` reads a file.

    Args:
        bus: Where it says it.
        name: Of the server.
    """

    def __init__(self, bus: Bus, name: str) -> None:
        self._bus, self._name = bus, name
        self._process, self._next = 0, 0

    def read(self, *, is_last: bool = False) -> list[str]:
        """Return the lines that are new; whether it `is_last` changes nothing, as all lines are whole."""
        log = decode_log(self._bus.get(keys.log(self._name)) or b"")
        if log is None:
            return []
        if log.process != self._process:
            self._process, self._next = log.process, 0
        new = log.lines[max(0, self._next - log.first) :]
        self._next = log.first + len(log.lines)
        return new
