"""What a recorder has heard of the station around it: which servers live, what they run, which motions they play."""

from __future__ import annotations

from typing import Any, Protocol

import msgspec

from station.bus import codec, keys
from station.bus import stamp as stamps
from station.episode.storage.manifest import Manifest, Policy, Robot

SILENT_AFTER_S = 3.0
"""A server says something twice a second; one that was silent this long is gone, whatever it said last."""

MAX_MOTIONS = 200
MAX_SERVERS = 200
MAX_BYTES = 1 << 20
"""Of a value that goes into the manifest; a G1 server states 3 kB."""
_LARGEST_MOTION = 64 * 1024
_SOURCE_PREFIX = keys.command_source("")
_ROBOTS = (keys.TWIST2_ROBOT, keys.TWIST_ROBOT)


class Server(msgspec.Struct):
    """A server's heartbeat: what it is, the process that said so, and when [ns, monotonic]."""

    role: str
    state: str
    source: str
    heard_ns: int


class Configuration(msgspec.Struct):
    """What a server stated that it runs, and the process that stated it."""

    source: str
    facts: dict[str, Any]


class Heard:
    """Listens to ``station:server:*``, ``station:config:*`` and ``command_source_*``."""

    def __init__(self) -> None:
        self._servers: dict[str, Server] = {}
        self._configurations: dict[str, Configuration] = {}
        self._robots_seen: set[str] = set()

    def is_of_interest(self, key: str) -> bool:
        """Whether `hear` wants the values of a key; also takes note of the key itself."""
        self._robots_seen.update(robot for robot in _ROBOTS if key.endswith(f"_body_{robot}"))
        return key.startswith((keys.SERVER_PREFIX, keys.CONFIG_PREFIX, _SOURCE_PREFIX))

    def hear(self, key: str, value: bytes, stamp: bytes | None, mono_ns: int) -> None:
        """Take note of one value; one that is not a JSON object says nothing."""
        facts = json_object(value)
        decoded = stamps.decode(stamp) if stamp is not None else None
        source = decoded.source if decoded else ""
        name = key.removeprefix(keys.SERVER_PREFIX).removeprefix(keys.CONFIG_PREFIX)
        is_full = len(self._servers) + len(self._configurations) >= 2 * MAX_SERVERS
        if facts is None or (is_full and name not in self._servers and name not in self._configurations):
            return
        if key.startswith(keys.SERVER_PREFIX):
            server = Server(str(facts.get("role", "")), str(facts.get("state", "")), source, mono_ns)
            self._servers[key.removeprefix(keys.SERVER_PREFIX)] = server
        elif key.startswith(keys.CONFIG_PREFIX):
            self._configurations[key.removeprefix(keys.CONFIG_PREFIX)] = Configuration(source, facts)

    def missing_configuration(self, now_ns: int) -> str | None:
        """Return why recording may not start: a low-level server that lives and has not said what it runs."""
        for name, server in self._servers.items():
            is_gone = server.state == "finalized" or now_ns - server.heard_ns > SILENT_AFTER_S * 1e9
            if server.role != "low-level" or is_gone:
                continue
            stated = self._configurations.get(name)
            if stated is None or stated.source != server.source:
                return (
                    f"low-level server {name!r} is up ({server.state}) but has not stated its configuration on "
                    f"{keys.server_config(name)}; start recording when it is ready"
                )
        return None

    @property
    def robot(self) -> str:
        """Suffix of the robot's keys: as a low-level server states it, else by the keys that were seen, else ""."""
        for stated in self._low_level().values():
            if isinstance(stated.get("robot"), str):
                return str(stated["robot"])
        return min(self._robots_seen, key=_ROBOTS.index, default="")

    def fill(self, manifest: Manifest) -> None:
        """Write what is known into a manifest; what it says already of robot, policy and operator stays."""
        manifest.servers = {name: stated.facts for name, stated in sorted(self._configurations.items())}
        for name, facts in self._low_level().items():
            if not manifest.robot.facts:
                manifest.robot = Robot(suffix=self.robot, facts=_mapping(facts.get("robot_facts")))
            if not manifest.policy.server:
                manifest.policy = _policy(name, _mapping(facts.get("policy")))
        manifest.robot.suffix = manifest.robot.suffix or self.robot
        manifest.operator.interface = manifest.operator.interface or self._commanders()

    def _low_level(self) -> dict[str, dict[str, Any]]:
        """Return what low-level servers stated, those first that are alive."""
        found = {n: c.facts for n, c in self._configurations.items() if c.facts.get("role") == "low-level"}
        return dict(sorted(found.items(), key=lambda item: (not self._is_current(item[0]), item[0])))

    def _commanders(self) -> str:
        """Return the names of the command servers that were heard, joined by ``+``; "" when only scripts command."""
        present = (name for name, s in self._servers.items() if s.role == "command" and s.state != "finalized")
        return "+".join(sorted(present))

    def _is_current(self, name: str) -> bool:
        server = self._servers.get(name)
        return server is not None and server.source == self._configurations[name].source


class HasMotions(Protocol):
    """A manifest, or what will be part of one."""

    motions: list[dict[str, Any]]


def note_motion(manifest: HasMotions, key: str, value: bytes) -> bool:
    """Add what a ``command_source`` key says, once per motion file; return whether it was new."""
    facts = json_object(value) if len(value) <= _LARGEST_MOTION else None
    if facts is None or len(manifest.motions) >= MAX_MOTIONS:
        return False
    identity = (key, facts.get("file"), facts.get("sha256"))
    if any((known.get("key"), known.get("file"), known.get("sha256")) == identity for known in manifest.motions):
        return False
    manifest.motions.append({"key": key, **facts})
    return True


def is_motion(key: str) -> bool:
    """Whether a key tells where a command comes from."""
    return key.startswith(_SOURCE_PREFIX)


def json_object(value: bytes) -> dict[str, Any] | None:
    """Return a JSON object from the bus, or None when the bytes are no such thing, or too much for a manifest."""
    if len(value) > MAX_BYTES:
        return None
    try:
        found = msgspec.json.decode(value, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    return found if codec.is_modest(found) else None


def _policy(server: str, facts: dict[str, Any]) -> Policy:
    names = ("name", "checkpoint", "sha256", "runtime", "command")
    rate = facts.get("rate_hz")
    return Policy(
        server=server,
        rate_hz=float(rate) if isinstance(rate, (int, float)) else None,
        facts=facts,
        **{name: str(facts.get(name, "")) for name in names},
    )


def _mapping(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}
