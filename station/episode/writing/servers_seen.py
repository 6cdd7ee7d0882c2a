"""What a recorder knows of the running station: which servers are alive, what they run, which motions they play."""

from __future__ import annotations

from typing import Any, Protocol

import msgspec

from station.bus import codec, contracts, keys
from station.bus import stamp as stamps
from station.bus.contracts import Contracts
from station.description import stated as described_in
from station.episode.storage.bounds import Cut, cut
from station.episode.storage.manifest import Manifest, Policy, Robot

SILENT_AFTER_S = 3.0
"""A server says something twice a second; one that was silent this long is gone, whatever it said last."""

MAX_MOTIONS = 200
MAX_SERVERS = 200
LARGEST_CONFIGURATION = 500_000
"""As `bounds.size_of` estimates it: 2500 numbers with their names, and envelopes of three policies."""
_LARGEST_MOTION = 20_000
_MOTION_IDENTITY = ("key", "file", "sha256")
_SOURCE_PREFIX = keys.command_source("")


class Server(msgspec.Struct):
    """A server's heartbeat: what it is, the process that said so, and when [ns, monotonic]."""

    role: str
    state: str
    source: str
    heard_ns: int


class Configuration(msgspec.Struct):
    """What a server stated that it runs, the process that stated it, and how much of it was cut."""

    source: str
    facts: dict[str, Any]
    cut: int


class ServersSeen:
    """Listens to ``station:server:*``, ``station:config:*`` and ``command_source_*``.

    Attributes:
        contracts: What is known of keys, as servers state it.
    """

    def __init__(self) -> None:
        self.contracts = Contracts()
        self._stock = contracts.robots()  # of programs that state nothing
        self._servers: dict[str, Server] = {}
        self._configurations: dict[str, Configuration] = {}
        self._robots_seen: set[str] = set()
        self._left_out = 0  # configurations of more servers than a manifest lists

    def is_of_interest(self, key: str) -> bool:
        """Whether `record` wants the values of a key; also takes note of the key itself."""
        if self.contracts.get(key) is not None:
            self._robots_seen.update(robot for robot in self._stock if key.endswith(f"_{robot}"))
        return key.startswith((keys.SERVER_PREFIX, keys.CONFIG_PREFIX, _SOURCE_PREFIX))

    def record(self, key: str, value: bytes, stamp: bytes | None, mono_ns: int) -> None:
        """Record one value; one that is not a JSON object says nothing."""
        stated = statement(value, LARGEST_CONFIGURATION)
        decoded = stamps.decode(stamp) if stamp is not None else None
        source = decoded.source if decoded else ""
        name = key.removeprefix(keys.SERVER_PREFIX).removeprefix(keys.CONFIG_PREFIX)
        is_full = len(self._servers) + len(self._configurations) >= 2 * MAX_SERVERS
        if stated is None:
            return
        if is_full and name not in self._servers and name not in self._configurations:
            self._left_out += key.startswith(keys.CONFIG_PREFIX)
            return
        facts, count = stated
        if key.startswith(keys.SERVER_PREFIX):
            server = Server(str(facts.get("role", "")), str(facts.get("state", "")), source, mono_ns)
            self._servers[key.removeprefix(keys.SERVER_PREFIX)] = server
        elif key.startswith(keys.CONFIG_PREFIX):
            self._configurations[key.removeprefix(keys.CONFIG_PREFIX)] = Configuration(source, facts, count)
            self.contracts.add_facts(facts)

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
        return min(self._robots_seen, key=self._stock.index, default="")

    @property
    def robot_in_names(self) -> str:
        """The robot's name in names of episodes; "" where no robot is known."""
        described = self.contracts.robot(self.robot)
        return (described.short if described is not None else "") or self.robot

    def fill(self, manifest: Manifest) -> None:
        """Write what is known into a manifest; what it says already of robot, policy and operator stays."""
        manifest.servers = {name: stated.facts for name, stated in sorted(self._configurations.items())}
        manifest.shortened.pop("servers", None)
        count_shortened(manifest, "servers", self._left_out + sum(one.cut for one in self._configurations.values()))
        for name, facts in self._low_level().items():
            if not manifest.robot.facts:
                manifest.robot = Robot(suffix=self.robot, facts=_mapping(facts.get("robot_facts")))
            if not manifest.policy.server:
                manifest.policy = _policy(name, _mapping(facts.get("policy")))
        manifest.robot.suffix = manifest.robot.suffix or self.robot
        manifest.operator.interface = manifest.operator.interface or self._commanders()

    def _low_level(self) -> dict[str, dict[str, Any]]:
        """Return what low-level servers stated: those first that are alive, and hands behind what has them."""
        found = {n: c.facts for n, c in self._configurations.items() if c.facts.get("role") == "low-level"}

        def rank(item: tuple[str, dict[str, Any]]) -> tuple[bool, bool, str]:
            described = described_in(item[1])
            return not self._is_current(item[0]), described is not None and described.is_carried, item[0]

        return dict(sorted(found.items(), key=rank))

    def _commanders(self) -> str:
        """Return the names of the live command servers, joined by ``+``; "" when only scripts command."""
        present = (name for name, s in self._servers.items() if s.role == "command" and s.state != "finalized")
        return "+".join(sorted(present))

    def _is_current(self, name: str) -> bool:
        server = self._servers.get(name)
        return server is not None and server.source == self._configurations[name].source


class Counts(Protocol):
    """A manifest, or what will be part of one, that counts what did not fit into it."""

    shortened: dict[str, int]


class HasMotions(Counts, Protocol):
    """The same with motions."""

    motions: list[dict[str, Any]]


def count_shortened(manifest: Counts, section: str, count: int) -> None:
    """Count what did not fit into a section of a manifest."""
    if count:
        manifest.shortened[section] = manifest.shortened.get(section, 0) + count


def add_motion(manifest: HasMotions, key: str, value: bytes) -> bool:
    """Add what a ``command_source`` key says, once per motion file; return whether that changed the manifest."""
    stated = statement(value, _LARGEST_MOTION)
    if stated is None:
        return False
    motion, count = cut({"key": key, **stated.value}, _LARGEST_MOTION)
    if any(all(known.get(name) == motion.get(name) for name in _MOTION_IDENTITY) for known in manifest.motions):
        return False
    is_full = len(manifest.motions) >= MAX_MOTIONS
    if not is_full:
        manifest.motions.append(motion)
    count_shortened(manifest, "motions", 1 if is_full else stated.cuts + count)
    return True


def is_motion(key: str) -> bool:
    """Whether a key tells where a command comes from."""
    return key.startswith(_SOURCE_PREFIX)


def statement(value: bytes, most: int) -> Cut | None:
    """Return a JSON object from the bus, cut to a size that a manifest has room for; None where it is no such thing.

    Args:
        value: From the bus.
        most: The size [bytes, as `bounds.size_of` estimates it].
    """
    too_large = Cut({"bytes": len(value)}, 1)
    if len(value) > codec.MAX_BYTES:
        return too_large
    try:
        found = codec.parse_struct(value, dict[str, Any])
    except codec.BadNumber:
        return too_large
    except codec.BadValue:
        return None
    return cut(found, most) if codec.is_modest(found) else too_large


def _policy(server: str, facts: dict[str, Any]) -> Policy:
    names = ("name", "checkpoint", "sha256", "runtime", "command")
    return Policy(
        server=server,
        rate_hz=codec.number(facts.get("rate_hz")),
        facts=facts,
        **{name: str(facts.get(name, "")) for name in names},
    )


def _mapping(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}
