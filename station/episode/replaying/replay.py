"""Replaying an episode to a bus: the recorded bytes, in the recorded order, on the recorded time line."""

from __future__ import annotations

import math
import threading
from array import array
from collections import deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple, get_args

import msgspec
import numpy as np

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.contracts import Contracts
from station.command_formats import command_formats
from station.contract import Role
from station.episode.reading.reader import EpisodeReader, Message
from station.errors import Refused, UnknownName, UsageError
from station.life.server import Health, read_configurations, read_health
from station.protocols import Floats

SOURCE = "replay"
_TIMEOUT_S = 1.0  # a replay may wait for the bus; what it may not do is leave out a message
_AHEAD = 500  # moments that are read before they are due: some seconds
_SLACK_NS = 5_000_000  # reading a chunk takes 2 to 3 ms; only done when that much time is left
_NAP_S = 0.05  # longest wait before a request to stop is seen

_LISTEN_S = 0.3  # six periods of a 20 Hz writer: a commander is heard within
COMMANDS = frozenset({"command"})
ROLES: tuple[str, ...] = (*get_args(Role), "unknown")
"""Every role that a key may have; ``unknown`` for a key without contract."""

_RATE_HZ = 50.0
_ARM_RAD_S = 0.2
"""Speed of the joint of an arm that has the farthest to go."""


_TOGETHER_NS = 500_000_000
"""What begins so soon after the first command begins with it."""


class WriteGroup(NamedTuple):
    """Writes that were one: the keys of one native command, or a single foreign write or deletion.

    Attributes:
        at_ns: When the recorder saw it, on the episode's clock [ns].
        values: Bytes by key; None for a deletion.
        is_native: Whether its writer stamped it.
    """

    at_ns: int
    values: dict[str, bytes | None]
    is_native: bool


class Replay(msgspec.Struct, kw_only=True):
    """How a replay went.

    Attributes:
        episode_id: What was replayed.
        bus: Where to.
        roles: Roles of the keys that were replayed, ``unknown`` for keys without contract.
        speed: Times the recorded speed.
        moments: Writes to the bus; one native command of several keys is one.
        messages: Keys written in them.
        skipped: Messages left out because of their role.
        lost: Messages that the bus did not take.
        eased_in_s: Time of the blend before the first command [s]; 0 when none was needed.
        seconds: From the first write to the last [s].
        lateness_p50_s, lateness_p99_s, lateness_max_s: How late after its deadline a moment was written [s].
        is_complete: Whether the end of the episode was reached.
    """

    episode_id: str
    bus: str
    roles: list[str]
    speed: float
    moments: int = 0
    messages: int = 0
    skipped: int = 0
    lost: int = 0
    eased_in_s: float = 0.0
    seconds: float = 0.0
    lateness_p50_s: float = 0.0
    lateness_p99_s: float = 0.0
    lateness_max_s: float = 0.0
    is_complete: bool = False


def to_bus(
    reader: EpisodeReader,
    address: BusAddress,
    *,
    speed: float = 1.0,
    roles: Collection[str] | None = None,
    allow_live: bool = False,
    ease_in_s: float = 1.0,
    stop: threading.Event | None = None,
) -> Replay:
    """Write an episode to a bus as it was recorded.

    Keys of native writers get a fresh stamp of the source ``replay``, one atomic command per recorded one; foreign
    keys are set as they were, without one.

    Args:
        reader: The episode.
        address: Where to.
        speed: Times the recorded speed; infinite sends without waiting.
        roles: Which keys, by role of their contract (``unknown`` without); None: everything on a bus where no server
            lives, all but requests where only recorders and sensors live, commands alone where a robot is driven.
        allow_live: Whether commands may go to a robot that is being driven on this bus.
        ease_in_s: Blend from the default pose into the first command, where a robot is driven [s].
        stop: Ends the replay early.

    Raises:
        BusError: the bus cannot be reached.
        Refused: a robot lives there and `allow_live` is not set, or another writer commands it.
        UsageError: a speed that is not positive.
    """
    if not speed > 0.0:
        raise UsageError(f"speed {speed}: expected a positive number, 1 for the recorded speed")
    with Bus(address, name=SOURCE, timeout_s=_TIMEOUT_S) as bus:
        target = inspect(bus)
        chosen = roles_for(target, roles, allow_live=allow_live, speed=speed)
        report = Replay(
            episode_id=reader.episode_id,
            bus=str(address),
            roles=sorted(chosen) if chosen is not None else ["everything"],
            speed=speed,
        )
        if target.is_driven:
            report.eased_in_s = ease_in(bus, reader, ease_in_s)
        _Player(bus, report, speed, stop or threading.Event()).run(moments(reader, chosen, report))
    return report


def moments(reader: EpisodeReader, roles: Collection[str] | None, report: Replay) -> Iterator[WriteGroup]:
    """Iterate over the recorded writes of some roles (None: all) in the order of the bus; counts the rest."""
    newest: tuple[Message, WriteGroup] | None = None
    for message in reader.messages():
        if roles is not None and role_of(message, reader) not in roles:
            report.skipped += 1
            continue
        if newest is not None and _is_one_write(*newest, message):
            newest[1].values[message.topic] = message.data
            continue
        if newest is not None:
            yield newest[1]
        value = None if message.channel.is_deletion else message.data
        newest = (message, WriteGroup(message.log_ns, {message.topic: value}, message.channel.is_native))
    if newest is not None:
        yield newest[1]


def role_of(message: Message, reader: EpisodeReader) -> str:
    """Return the role of a message by its recorded contract, else as its episode knows its key, else ``unknown``."""
    contract = message.channel.contract or reader.contract(message.topic)
    return contract.role if contract is not None else "unknown"


def _is_one_write(first: Message, moment: WriteGroup, message: Message) -> bool:
    return (
        moment.is_native
        and not message.channel.is_deletion
        and first.channel.source == message.channel.source
        and first.publish_ns == message.publish_ns
        and message.topic not in moment.values
    )


class _Player:
    """Writes moments at their deadlines; each deadline counts from the start, so that nothing adds up."""

    def __init__(self, bus: Bus, report: Replay, speed: float, stop: threading.Event) -> None:
        self._bus, self._report, self._speed, self._stop = bus, report, speed, stop
        self._clock = bus.clock
        self._lateness: array[int] = array("q")

    def run(self, recorded: Iterator[WriteGroup]) -> None:
        ahead = deque(islice(recorded, 1))
        began_ns = self._clock.monotonic_ns()
        first_ns = ahead[0].at_ns if ahead else 0
        while ahead and not self._stop.is_set():
            moment = ahead.popleft()
            due_ns = began_ns + self._delay_ns(moment.at_ns - first_ns)
            self._read_ahead(ahead, recorded, due_ns)
            if not self._wait(due_ns):
                break
            self._lateness.append(max(0, self._clock.monotonic_ns() - due_ns))
            self._write(moment)
        else:
            self._report.is_complete = not ahead
        self._conclude((self._clock.monotonic_ns() - began_ns) * 1e-9)

    def _delay_ns(self, recorded_ns: int) -> int:
        return 0 if math.isinf(self._speed) else round(recorded_ns / self._speed)

    def _read_ahead(self, ahead: deque[WriteGroup], recorded: Iterator[WriteGroup], due_ns: int) -> None:
        while not ahead or (len(ahead) < _AHEAD and self._clock.monotonic_ns() < due_ns - _SLACK_NS):
            found = next(recorded, None)
            if found is None:
                return
            ahead.append(found)

    def _wait(self, due_ns: int) -> bool:
        """Sleep until a deadline; False when asked to stop before."""
        while (left_s := (due_ns - self._clock.monotonic_ns()) * 1e-9) > _NAP_S:
            if self._clock.wait(self._stop, min(left_s - _NAP_S / 2, _NAP_S)):
                return False
        self._clock.sleep_until(due_ns)
        return not self._stop.is_set()

    def _write(self, moment: WriteGroup) -> None:
        report = self._report
        report.moments += 1
        report.messages += len(moment.values)
        present = {key: value for key, value in moment.values.items() if value is not None}
        if moment.is_native and present:
            report.lost += 0 if self._bus.publish(present) else len(present)
            return
        for key, value in moment.values.items():
            if value is None:
                self._bus.call("DEL", key)
            else:
                self._bus.call("SET", key, value)

    def _conclude(self, seconds: float) -> None:
        late_s = np.array(self._lateness, dtype=np.int64) * 1e-9
        report = self._report
        report.seconds = seconds
        if len(late_s):
            report.lateness_p50_s, report.lateness_p99_s = (float(p) for p in np.percentile(late_s, (50, 99)))
            report.lateness_max_s = float(late_s.max())


@dataclass(frozen=True)
class Target:
    """Who lives on a bus.

    Attributes:
        robots: Low-level servers, and state keys that a foreign program writes.
        commanders: Command servers, and command keys that are written.
        others: Recorders and sensors.
    """

    robots: tuple[str, ...] = ()
    commanders: tuple[str, ...] = ()
    others: tuple[str, ...] = ()

    @property
    def is_driven(self) -> bool:
        """Whether a robot, real or simulated, takes commands from this bus."""
        return bool(self.robots)

    @property
    def is_empty(self) -> bool:
        """Whether no server lives there."""
        return not (self.robots or self.commanders or self.others)


def inspect(bus: Bus) -> Target:
    """Return what lives on a bus: by heartbeats, and by what stock scripts without one write within a moment."""
    alive = [health for health in read_health(bus) if health.is_alive and not _is_replayed(bus, health)]
    written = _written_now(bus)
    by_role: dict[str, list[str]] = {"low-level": [], "command": []}
    others: list[str] = []
    for health in alive:
        by_role.get(health.role, others).append(health.name)
    return Target(
        robots=tuple(by_role["low-level"] or written["state"]),
        commanders=tuple(by_role["command"] or written["command"]),
        others=tuple(others),
    )


def roles_for(
    target: Target, wanted: Collection[str] | None, *, allow_live: bool, speed: float
) -> frozenset[str] | None:
    """Return the roles to replay, None for everything.

    Raises:
        Refused: a robot lives there and that is not allowed, or another writer commands it.
        UnknownName: no such role.
    """
    for role in wanted or ():
        if role not in ROLES:
            raise UnknownName("role", role, ROLES)
    if target.commanders:
        raise Refused(
            f"replay: {', '.join(target.commanders)} is writing commands on this bus, and two writers of one command "
            "key throw a robot about; stop it first"
        )
    if target.is_driven:
        return _for_a_robot(target, wanted, allow_live=allow_live, speed=speed)
    if wanted is not None:
        return frozenset(wanted)
    # A recorder would obey a recorded request to record; on an empty bus there is none.
    return None if target.is_empty else frozenset(ROLES) - {"control"}


def _for_a_robot(target: Target, wanted: Collection[str] | None, *, allow_live: bool, speed: float) -> frozenset[str]:
    who = ", ".join(target.robots)
    if not allow_live:
        raise Refused(
            f"replay: a robot is driven on this bus ({who}) and would move; clear its surroundings and allow it, "
            "or replay to another bus"
        )
    if speed > 1.0:
        raise Refused(f"replay: speed {speed:g} to a robot that is driven ({who}); expected at most 1")
    roles = frozenset(wanted) if wanted is not None else COMMANDS
    if roles - COMMANDS:
        raise Refused(
            f"replay: roles {', '.join(sorted(roles - COMMANDS))} to a bus where {who} writes its own; "
            "only commands may be replayed to a robot"
        )
    return roles


def _written_now(bus: Bus) -> dict[str, list[str]]:
    """Return the state and command keys that are written while we listen."""
    suspects = {
        item.key: item.role for item in Contracts(read_configurations(bus)).all() if item.role in ("state", "command")
    }
    written: dict[str, list[str]] = {"state": [], "command": []}
    with bus.watch(list(suspects)) as watch:
        bus.clock.sleep(_LISTEN_S)
        for key, role in suspects.items():
            sample = watch.latest(key)
            if sample is not None and sample.arrived_ns is not None:
                written[role].append(key)
    return written


def _is_replayed(bus: Bus, health: Health) -> bool:
    """Whether a heartbeat was put there by a replay: it names the server that was recorded, not its writer."""
    key = keys.server(health.name)
    sample = bus.read([key]).get(key)
    return sample is None or sample.stamp is None or sample.stamp.source != health.source


class _Blend(NamedTuple):
    key: str
    start: Floats
    goal: Floats
    duration_s: float


def ease_in(bus: Bus, reader: EpisodeReader, duration_s: float) -> float:
    """Send a blend into the first command of an episode; return its length [s], 0 when there is none.

    Args:
        bus: Where to.
        reader: The episode.
        duration_s: Length of the blend [s]; of an arm's at least, which takes as long as it has to go.
    """
    blends = _blends(bus, reader, duration_s) if duration_s > 0.0 else []
    if not blends:
        return 0.0
    steps = max(1, round(max(blend.duration_s for blend in blends) * _RATE_HZ))
    began_ns = bus.clock.monotonic_ns()
    for step in range(steps):
        bus.clock.sleep_until(began_ns + round(step / _RATE_HZ * 1e9))
        share = step / steps
        bus.publish({each.key: codec.json_vector(each.start + (each.goal - each.start) * share) for each in blends})
    bus.clock.sleep_until(began_ns + round(steps / _RATE_HZ * 1e9))
    return steps / _RATE_HZ


def _blends(bus: Bus, reader: EpisodeReader, duration_s: float) -> list[_Blend]:
    """Return a blend for each command that the episode begins with."""
    robots = [robot for facts in reader.manifest.servers.values() if isinstance(robot := facts.get("robot"), str)]
    places = {each.key: each.default for each in command_formats(robots) if each.key and not each.holds_position}
    arms = {key for key in reader.topics() if key.startswith(keys.action_joints("")) and not keys.is_stamp(key)}
    found: list[_Blend] = []
    until_ns: int | None = None
    for message in reader.messages({*places, *arms}):
        if until_ns is not None and message.log_ns > until_ns:
            break
        if message.topic in [blend.key for blend in found]:
            continue
        is_arm = message.topic in arms
        start = _where_it_is(bus, message.topic) if is_arm else places[message.topic]
        try:
            goal = codec.parse_json_vector(message.data, None if start is None else len(start))
        except codec.BadValue:
            continue  # the gate refuses it as it did then
        until_ns = message.log_ns + _TOGETHER_NS if until_ns is None else until_ns
        if start is not None:  # else that arm is not driven here
            takes_s = float(np.abs(goal - start).max()) / _ARM_RAD_S if is_arm else 0.0
            found.append(_Blend(message.topic, start, goal, max(duration_s, takes_s)))
    return found


def _where_it_is(bus: Bus, key: str) -> Floats | None:
    """Return where an arm's server says that its arm is, shape (n,) [rad]; None where none says so."""
    data = bus.get(keys.command_used(key.removeprefix(keys.action_joints(""))))
    try:
        return None if data is None else codec.parse_f64(data)
    except codec.BadValue:
        return None
