"""Replaying an episode to a bus: the recorded bytes, in the recorded order, on the recorded time line."""

from __future__ import annotations

import math
import threading
from array import array
from collections import deque
from collections.abc import Collection, Iterator
from itertools import islice
from typing import NamedTuple

import msgspec
import numpy as np

from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.reading.reader import EpisodeReader, Message
from station.episode.replaying.ease_in import ease_in
from station.episode.replaying.replay_target import look_at, roles_for
from station.errors import UsageError

SOURCE = "replay"
_TIMEOUT_S = 1.0  # a replay may wait for the bus; what it may not do is leave out a message
_AHEAD = 500  # moments that are read before they are due: some seconds
_SLACK_NS = 5_000_000  # reading a chunk takes 2 to 3 ms; only done when that much time is left
_NAP_S = 0.05  # longest wait before a request to stop is seen


class Moment(NamedTuple):
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
        roles: Which keys, by role of their contract (``unknown`` without); None: everything on a bus where nobody
            lives, all but requests where only recorders and sensors live, commands alone where a robot is driven.
        allow_live: Whether commands may go to a robot that is being driven on this bus.
        ease_in_s: Blend from the default pose into the first command, where a robot is driven [s].
        stop: Ends the replay early.

    Raises:
        BusError: the bus cannot be reached.
        Refused: a robot lives there and `allow_live` is not set, or somebody else commands it.
        UsageError: a speed that is not positive.
    """
    if not speed > 0.0:
        raise UsageError(f"speed {speed}: expected a positive number, 1 for the recorded speed")
    with Bus(address, name=SOURCE, timeout_s=_TIMEOUT_S) as bus:
        target = look_at(bus)
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


def moments(reader: EpisodeReader, roles: Collection[str] | None, report: Replay) -> Iterator[Moment]:
    """Iterate over the recorded writes of some roles (None: all) in the order of the bus; counts the rest."""
    newest: tuple[Message, Moment] | None = None
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
        newest = (message, Moment(message.log_ns, {message.topic: value}, message.channel.is_native))
    if newest is not None:
        yield newest[1]


def role_of(message: Message, reader: EpisodeReader) -> str:
    """Return the role of a message by its recorded contract, else as its episode knows its key, else ``unknown``."""
    contract = message.channel.contract or reader.contract(message.topic)
    return contract.role if contract is not None else "unknown"


def _is_one_write(first: Message, moment: Moment, message: Message) -> bool:
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

    def run(self, recorded: Iterator[Moment]) -> None:
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

    def _read_ahead(self, ahead: deque[Moment], recorded: Iterator[Moment], due_ns: int) -> None:
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

    def _write(self, moment: Moment) -> None:
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
