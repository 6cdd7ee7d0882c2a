"""Why "it runs and the robot does nothing": looks at every link of the chain and names the remedy of what is broken."""

from __future__ import annotations

import os
import platform
import re
import ssl
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import msgspec

from station import assets, libraries, packages, registry, user_config
from station.arms import remedy_of
from station.bus import address as addresses
from station.bus import clocks, codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.protection import REMEDY, inspect
from station.bus.sample import Sample
from station.bus.server_options import LARGEST_VALUE
from station.bus.watch import Watch
from station.episode.storage.request import RecorderState
from station.errors import BusError, StationError, UnknownName
from station.life import stop_file
from station.life.server import Health, read_configurations, read_health
from station.life.stop_file import LatchedStop, StopFile
from station.printable import printable
from station.software import software
from station.supervision import hosts
from station.supervision.supervisor import log_folder

_LOOK_S = 1.0
_SOON_DAYS = 14
_FAR_MS = 1.0  # a round trip within a machine takes 0.2 ms
_SETTINGS = ("notify-keyspace-events", "maxmemory-policy", "proto-max-bulk-len")
_GATE_REMEDIES = {
    "waiting": "the robot stands until a fresh, valid command comes; see the command key above",
    "holding": "the command stopped coming a moment ago; see the command key above",
    "returning": "the command stopped coming; the robot goes back to its default pose",
    "stopped": "station estop --reset",
}

_INFO_MEMORY = re.compile(r"used_memory_human:(\S+)")
_PACKAGES = (packages.DISTRIBUTION, "mujoco", "onnxruntime", "numpy", "hiredis", "mcap", "rerun-sdk")


class _StatedPolicy(msgspec.Struct):
    command: str


class _StatedCommand(msgspec.Struct):
    key: str
    auxiliary: list[str] = []


class _Stated(msgspec.Struct):
    """What we need of the facts that a low-level server states: what it obeys, or the policy that says so."""

    robot: str
    policy: _StatedPolicy | None = None
    command: _StatedCommand | None = None

    def obeys(self) -> list[_StatedCommand]:
        """Return the keys of its command, or of the commands of its parts.

        Raises:
            UnknownName: its policy follows a format that is not registered.
        """
        if self.policy is None:
            return [self.command or _StatedCommand("")]
        from station.command_formats import command_format  # it loads NumPy, as the format has
        from station.parts import parts_of

        followed = command_format(self.policy.command, self.robot)
        return [_StatedCommand(part.key, list(part.auxiliary)) for part in parts_of(followed)]


class _Gate(msgspec.Struct):
    """What we need of the gate's word."""

    state: str
    reason: str = ""
    arming: str = ""


def examine(bus: Bus) -> Iterator[Finding]:
    """Inspect a station through its bus; yields findings from the bus outwards."""
    yield from _server_settings(bus)
    yield from _bulk(bus)
    servers = read_health(bus)
    yield from _servers(servers, log_folder(bus.address))
    yield _estop(stop_file.latched(bus))
    yield from _hosts([health for health in servers if health.is_alive])
    yield from _clocks(bus, [health for health in servers if health.is_alive])
    low_level = [health for health in servers if health.role == "low-level" and health.is_alive]
    for health in low_level:
        yield from _low_level(bus, health)
    if not low_level:
        yield from _commands_without_a_robot(bus)
    yield from _recorder(bus, read_health(bus))  # to look at commands takes a second each: what was heard before is old
    yield from machine()


def _server_settings(bus: Bus) -> Iterator[Finding]:
    info = bus.call("INFO", "server").decode()
    fields = dict(line.split(":", 1) for line in info.splitlines() if ":" in line)
    version = fields.get("valkey_version") or fields.get("redis_version", "?")
    yield Finding("ok", "bus", f"{bus.address}, server {version}, up {fields.get('uptime_in_seconds', '?')} s")
    yield bus_access(bus)
    yield from _certificate(bus)
    try:
        settings = {name: _setting(bus, name) for name in _SETTINGS}
    except BusError as error:
        yield Finding(
            "warning", "bus settings", str(error), "allow CONFIG GET, or look at the server's settings yourself"
        )
        return
    if "K" not in settings["notify-keyspace-events"]:
        yield Finding(
            "warning", "bus notifications", "off; readers poll", "a low-level server switches them on by itself"
        )
    if int(settings["proto-max-bulk-len"] or 0) > LARGEST_VALUE:
        yield Finding("warning", "bus values", f"of up to {int(settings['proto-max-bulk-len']) >> 20} MiB are taken, "
                      "which every reader must then hold", "CONFIG SET proto-max-bulk-len 64mb")  # fmt: skip
    if settings["maxmemory-policy"] != "noeviction":
        yield Finding("warning", "bus memory", f"policy {settings['maxmemory-policy']} may drop a command key",
                      "CONFIG SET maxmemory-policy noeviction")  # fmt: skip


def _bulk(bus: Bus) -> Iterator[Finding]:
    """Yield how the bulk bus is, where there is one, and servers that take another one for it."""
    if bus.bulk_address is not None:
        try:
            used = _INFO_MEMORY.search(bus.open_bulk().call("INFO", "memory").decode())
        except BusError as error:
            yield Finding("broken", "bulk bus", str(error), "station bus start --bulk")
        else:
            yield Finding("ok", "bulk bus", f"{bus.bulk_address}, holds {used[1] if used else '?'}")
    ours = "" if bus.bulk_address is None else str(bus.bulk_address)
    alive = {health.name for health in read_health(bus) if health.is_alive}
    for facts in read_configurations(bus):
        stated = facts.get("bulk")
        if isinstance(stated, str) and stated != ours and facts.get("server") in alive:
            named = f"{printable(stated) or 'none'}, not {ours or 'none'}"
            yield Finding("broken", "bulk bus", f"{facts['server']} has {named}: what it writes there is not recorded",
                          f"name one in ${addresses.BULK_VARIABLE} for all of them, and start them again")  # fmt: skip


def _setting(bus: Bus, name: str) -> str:
    answer = bus.call("CONFIG", "GET", name)
    return answer[1].decode() if len(answer) > 1 else ""


def _servers(servers: list[Health], logs: Path) -> Iterator[Finding]:
    alive = [health for health in servers if health.is_alive]
    if not alive:
        yield Finding("broken", "servers", "none runs on this bus", "start a station: station up g1-sim-motion")
    for health in servers:
        if health.is_alive:
            remedy = "" if health.state == "active" else "it waits for its supervisor; is a confirmation open there?"
            yield Finding("ok" if health.state == "active" else "warning", f"server {health.name}",
                          f"{health.state} (pid {health.pid})", remedy)  # fmt: skip
            if why := health.why_late:
                found = f"{why} ({health.rate_hz:.0f} of {health.nominal_hz:.0f} Hz)"
                todo = "end what else runs there (`top`); a simulation takes less with a longer physics_dt_s"
                yield Finding("warning", f"loop of {health.name}", found, todo)
        elif health.state != "finalized":
            log = logs / f"{health.name}.log"
            is_there = log in logs.glob("*.log")  # of a name from the bus, which may be no name of a file at all
            yield Finding("broken", f"server {health.name}", f"fell silent without a farewell (pid {health.pid})",
                          (f"see {log}; " if is_there else "") + "start it, or its station, again")  # fmt: skip
    if alive and not any(health.role == "low-level" for health in alive):
        yield Finding("broken", "low-level server", "none of ours runs: nothing turns commands into motion",
                      "station serve g1 (or start your stock low-level script)")  # fmt: skip


def _estop(latched: LatchedStop | None) -> Finding:
    if latched is None:
        return Finding("ok", "e-stop", "released")
    return Finding("broken", "e-stop", latched.found, latched.remedy)


def _hosts(alive: list[Health]) -> Iterator[Finding]:
    """Yield which machines a station may start servers on, and whether they have the same version as this one."""
    ours = software().version
    for health in alive:
        if (facts := hosts.facts_of(health)) is None:
            continue
        name = hosts.host_of(health.name)
        does = f"runs {', '.join(facts.servers)} for {facts.who}" if facts.who else "runs nothing"
        found = f"version {facts.version or 'unknown'}, {does}, {facts.free_gb:.0f} GB free at {facts.data}"
        is_same = facts.version == ours
        yield Finding("ok" if is_same else "warning", f"host {name}", found, "" if is_same else
                      f"this machine has version {ours or 'unknown'}: install the same on both")  # fmt: skip


def _certificate(bus: Bus) -> Iterator[Finding]:
    """Yield until when the certificate of a bus with TLS is valid."""
    if not bus.address.tls:
        return
    with bus.address.open(_LOOK_S) as line:
        said = line.getpeercert() if isinstance(line, ssl.SSLSocket) else None
    until = str((said or {}).get("notAfter", ""))
    days = (ssl.cert_time_to_seconds(until) - bus.clock.wall_ns() * 1e-9) / 86400 if until else 0.0
    level: Literal["ok", "warning"] = "ok" if days > _SOON_DAYS else "warning"
    yield Finding(level, "bus certificate", f"valid until {until or 'unknown'}, {days:.0f} days",
                  "" if level == "ok" else "make a new one, and start the bus again with it")  # fmt: skip


def _clocks(bus: Bus, alive: list[Health]) -> Iterator[Finding]:
    """Yield where the bus is not beside a robot, and what is known of the clocks of several machines."""
    hosts = {health.boot: health.host for health in alive}
    said = {boot: clocks.decode_statement(bus.get(keys.clock(boot)), boot) for boot in hosts}
    for health in alive:
        statement = said[health.boot] if health.role == "low-level" else None
        if statement is not None and (trip_ms := statement.round_trip_ns * 1e-6) > _FAR_MS:
            yield Finding("warning", f"server {health.name}", f"the bus is {trip_ms:.1f} ms away, there and back: each "
                          "command comes as much later, and a lost packet on that line holds it up",
                          f"run the bus on {health.host}, beside the robot's server: docs/hosts.md")  # fmt: skip
    if len(hosts) < 2:
        return
    of_robots = {health.boot for health in alive if health.role == "low-level"}
    for boot, host in sorted(hosts.items(), key=lambda item: item[1]):
        subject, statement = f"clock of {host}", said[boot]
        commands = [health.name for health in alive if health.boot == boot and health.role == "command"]
        if statement is not None:
            by = {True: ", kept right by its system", False: ", kept right by nothing", None: ""}
            error_ms, trip_ms = statement.error_ns * 1e-6, statement.round_trip_ns * 1e-6
            yield Finding("ok", subject, f"known to {error_ms:.1f} ms (round trip {trip_ms:.1f} ms); its wall clock is "
                          f"{statement.wall_ahead_ns * 1e-9:+.3f} s from the bus server's"
                          f"{by[statement.is_synchronised]}")  # fmt: skip
        elif commands and boot not in of_robots:
            yield Finding("warning", subject, f"not known: commands of {', '.join(commands)} count by arrival alone, "
                          "so old ones may be followed after a cut",
                          "reach the bus by a network address there, not by a tunnel to localhost")  # fmt: skip


def _low_level(bus: Bus, health: Health) -> Iterator[Finding]:
    subject = f"server {health.name}"
    try:
        facts = codec.parse_struct(bus.get(keys.server_config(health.name)) or b"", _Stated)
        commands = facts.obeys()
    except (codec.BadValue, UnknownName) as error:
        yield Finding("broken", subject, f"has not stated what it runs ({error})", "restart it; recording refuses it")
        return
    gate = keys.command_gate(facts.robot)
    auxiliary = [key for command in commands for key in command.auxiliary]
    with bus.watch([*(command.key for command in commands), *auxiliary, gate]) as watch:
        for command in commands:
            yield _command(watch, command.key, _sources(watch, command.key))
        for key in auxiliary:
            if watch.latest(key) is None:
                yield Finding("warning", key, "not written; only a stock low-level server needs it",
                              "nothing, unless you swap in a stock server")  # fmt: skip
        yield from _gate(watch, gate)
    now = next((other for other in read_health(bus) if other.name == health.name), health)
    yield from _troubles(now, commands[0].key)


def _troubles(health: Health, key: str) -> Iterator[Finding]:
    """Yield what a low-level server has counted since it started."""
    refused = health.detail.get("refused")
    if isinstance(refused, dict) and refused:
        listed = ", ".join(f"{reason} ({count} times)" for reason, count in refused.items())
        yield Finding("warning", key, f"commands refused since the start: {listed}",
                      f"mend its writer: station keys {key}")  # fmt: skip
    yield from _against_arming(health)
    if falls := health.detail.get("falls"):
        yield Finding("warning", f"server {health.name}", f"the robot has fallen ({falls} times since the start)",
                      "a simulated one is put back on its feet by: station estop --reset")  # fmt: skip


def _against_arming(health: Health) -> Iterator[Finding]:
    """Yield what a robot that checks itself has against being armed, and whether anything would damp it without us."""
    subject, why_not = f"server {health.name}", health.detail.get("why_not_arm")
    if not isinstance(why_not, str):
        return
    if why_not:
        yield Finding("broken", subject, f"its robot is not to be armed: {why_not}", "mend that, then: station arm")
    else:
        yield Finding("ok", subject, "nothing is against arming its robot")
    if health.detail.get("guard") == "none":
        yield Finding("warning", subject, "no guard owns the motors: who damps the robot when this server dies, or its "
                      "cable is cut?",
                      "run its guard, and name that in robot_options")  # fmt: skip
    elif health.detail.get("guard_is_beside_us"):
        yield Finding("warning", subject, "its guard runs on this computer: it damps the robot when this server dies, "
                      "not when the robot's cable is cut",
                      "run the guard on the robot's computer, unless this is that")  # fmt: skip


def _commands_without_a_robot(bus: Bus) -> Iterator[Finding]:
    """Yield which writers command when no low-level server of ours tells which commands it wants."""
    for name in registry.names("command"):
        key = registry.find(
            "command", name
        ).key  # "" of one that is made of parts, which are registered too, or for any
        if key and bus.get(key) is not None:
            with bus.watch([key]) as watch:
                yield _command(watch, key, _sources(watch, key))


def _sources(watch: Watch, key: str) -> dict[str, int]:
    """Count the writes of each source to a key for a moment; native ones by their numbers, so also those not seen."""
    counts, first = dict[str, int](), dict[str, int]()
    newest, deadline = None, watch.clock.monotonic_s() + _LOOK_S
    while (remaining := deadline - watch.clock.monotonic_s()) > 0:
        sample = watch.wait(key, after=newest, timeout_s=remaining)
        if sample is not None:
            source = _who(sample)
            counts[source] = counts.get(source, 0) + 1
            if sample.stamp is not None:
                counts[source] = sample.stamp.seq - first.setdefault(source, sample.stamp.seq) + 1
            newest = sample
    return counts


def _command(watch: Watch, key: str, sources: dict[str, int]) -> Finding:
    if len(sources) > 1:
        found = ", ".join(f"{source} {count / _LOOK_S:.0f} Hz" for source, count in sources.items())
        return Finding("broken", key, f"rival writers: {found}", "stop all but one of them")
    if sources:
        source, count = next(iter(sources.items()))
        return Finding("ok", key, f"written by {source} at {count / _LOOK_S:.0f} Hz")
    sample = watch.latest(key)
    if sample is None:
        return Finding(
            "broken", key, "nobody has ever written it", "start a command server: station serve motion --set …"
        )
    when = f", {(watch.clock.wall_ns() - sample.stamp.wall_ns) * 1e-9:.1f} s ago" if sample.stamp else ""
    return Finding("broken", key, f"stale: nobody writes it now (last: {_who(sample)}{when})",
                   "start its command server again, or resume it")  # fmt: skip


def _who(sample: Sample) -> str:
    """Return the writer of a value: name and process, or that it writes no stamps."""
    if sample.stamp is None:
        return "a foreign writer"
    return f"{sample.stamp.writer} (pid {sample.stamp.pid})"


def _gate(watch: Watch, key: str) -> Iterator[Finding]:
    sample = watch.latest(key)
    if sample is None or sample.age_s(watch.clock.monotonic_ns()) > _LOOK_S:
        yield Finding("broken", "gate", "no word from it: the low-level loop does not run", "station logs")
        return
    try:
        gate = codec.parse_struct(sample.value, _Gate)
    except codec.BadValue as error:
        yield Finding("broken", "gate", f"its word cannot be read ({error})", "is a foreign writer on its key?")
        return
    remedy = remedy_of(gate.reason) if gate.state == "faulted" else _GATE_REMEDIES.get(gate.state, "")
    yield Finding(
        "warning" if remedy or gate.state == "faulted" else "ok",
        "gate",
        f"{gate.state}: {gate.reason}".rstrip(": "),
        remedy,
    )
    if gate.arming == "disarmed":
        yield Finding("broken", "arming", "disarmed: the policy runs, and nothing is sent to the robot",
                      "when everybody is clear: station arm")  # fmt: skip


def _recorder(bus: Bus, servers: list[Health]) -> Iterator[Finding]:
    if not any(health.role == "recorder" and health.is_alive for health in servers):
        yield Finding("warning", "recorder", "none runs; nothing is kept", "station serve recorder")
        return
    try:
        state = codec.parse_struct(bus.get(keys.RECORDER) or b"", RecorderState)
    except codec.BadValue:
        yield Finding("warning", "recorder", "runs and has not reported its state", "station logs recorder")
        return
    found = f"recording {state.episode_id}" if state.episode_id else "idle; `station record start` begins an episode"
    if state.dropped or state.error:
        found += f"; {state.dropped} writes dropped" * bool(state.dropped) + f"; {state.error}" * bool(state.error)
        yield Finding("broken", "recorder", found, "is the disk full or too slow?")
    else:
        yield Finding("ok", "recorder", found)


def run(address: BusAddress) -> list[Finding]:
    """Examine a station; packages of others that hide ours, or a bus that cannot be reached, are the first finding."""
    if hidden := hidden_packages():
        return [*hidden, _estop(StopFile(address).read()), *machine()]
    try:
        bus = Bus(address, name="doctor", timeout_s=1.0)
    except StationError as error:
        found, _, remedy = str(error).removeprefix("bus ").partition("; ")
        return [Finding("broken", "bus", found, remedy or "station up RUNBOOK"),
                _estop(StopFile(address).read()), *machine()]  # fmt: skip
    with bus:
        return list(examine(bus))


class Finding(msgspec.Struct, frozen=True):
    """One thing that was looked at.

    Attributes:
        level: ``ok``, ``warning`` (works, but look) or ``broken``.
        subject: What was looked at.
        found: What was found.
        remedy: What to do; empty when nothing.
    """

    level: Literal["ok", "warning", "broken"]
    subject: str
    found: str
    remedy: str = ""


def bus_access(bus: Bus) -> Finding:
    """Return which clients can reach a bus."""
    protection = inspect(bus)
    level: Literal["ok", "warning", "broken"] = (
        "ok" if protection.verdict == "closed" else "broken" if protection.verdict == "open" else "warning"
    )
    return Finding(level, "bus access", protection.found, "" if level == "ok" else REMEDY)


def hidden_packages() -> list[Finding]:
    """Return which packages of others hide ours; without ours nothing can be found by its name."""
    return [Finding("broken", f"package {name}", found.found, found.remedy)
            for name in packages.IMPORTED if (found := packages.hiding(name)) is not None]  # fmt: skip


def machine() -> Iterator[Finding]:
    """Yield findings about this machine: upstream data, packages, versions, scheduling."""
    if outdated := registry.outdated():
        yield Finding("broken", "installation", outdated, f"install it again: {registry.INSTALL}")
    yield from _defaults()
    base = assets.root()
    if base is None:
        yield Finding("ok", "assets", f"built in; ${assets.ENVIRONMENT_VARIABLE} is not set, cache {assets.cache()}")
    elif not base.is_dir():
        yield Finding("broken", "assets", f"{base} is not a folder", f"mend ${assets.ENVIRONMENT_VARIABLE}")
    else:
        yield Finding("ok", "assets", str(base))
    for name in packages.IMPORTED:
        if (shared := packages.sharing(name)) is not None:
            yield Finding("warning", f"package {name}", shared.found, shared.remedy)
    missing = [name for name in _PACKAGES if libraries.version(name) is None]
    versions = ", ".join(f"{name} {libraries.version(name) or 'MISSING'}" for name in _PACKAGES)
    yield Finding("broken" if missing else "ok", "versions", f"python {platform.python_version()}, {versions}",
                  f"pip install {' '.join(missing)}" if missing else "")  # fmt: skip
    yield _scheduling()


def _defaults() -> Iterator[Finding]:
    """Yield what this user's file sets; of an address without its password."""
    found = user_config.user_config()
    named = {name: url and addresses.parse(url) for name, url in (("bus", found.bus), ("bulk", found.bulk))}
    chosen = {"data": found.data, **named, "operator": found.operator}
    if listed := ", ".join(f"{name} {value}" for name, value in chosen.items() if value):
        yield Finding("ok", "defaults", f"{listed} ({user_config.path()})")


def _scheduling() -> Finding:
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, *before)
    except (PermissionError, AttributeError):
        return Finding("warning", "scheduling", "real-time scheduling is not permitted",
                       "for a steady loop on a busy machine grant rtprio in /etc/security/limits.conf")  # fmt: skip
    return Finding("ok", "scheduling", "real-time scheduling is permitted")
