"""What must hold in every tick of a robot, whatever came before: judged by what was written on the bus and when.

It knows nothing of the product's own reckoning but the vectors, gains and states that it decided on.
"""

from __future__ import annotations

import bisect
import json
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from station.bus import codec, keys, stamp
from station.life import estop
from station.life.writer_conflict import FOREIGN
from station.protocols import Floats
from tests.control.ideal_robot import Obedient
from tests.virtual.station import FORMAT, Tick

EPSILON = 1e-9
HOLD_AFTER_S, STALE_AFTER_S, FADE_S, SILENT_S = 0.1, 0.25, 0.2, 0.3
"""What is promised [s]: of a command's arrival, of its writing, of velocities after it, of silence after a stop."""

QUICK_S = 0.006
"""From the bus to the loop where nothing is in the way: latencies and late wakes [s]."""

ACTED_S = 0.065
"""A stop is acted on within three ticks [s]."""

LONGEST_TICK_S = 0.04  # of a rate
COUNTED_S = 0.1
"""A tick counts for no more, where a process stood still [s]."""

LATE_TICK_S = 0.021
"""A tick is a period later than the instant that it is about, at most, and its server wakes late [s]."""

FOLLOWS = ("entering", "tracking")
BLEND_S, RAMP_S = 1.0, 2.0
STIFFNESS = Obedient().spec.kp


Complaint = tuple[Tick, Tick, str]
"""The tick before, the tick, and what does not hold."""


@dataclass(frozen=True, slots=True)
class Write:
    """A command on the bus: when it was done there [s], when it was written by this machine's clock, or None [s]."""

    done_s: float
    written_s: float | None
    source: str
    vector: Floats | None


class Bus:
    """What was written, in order.

    Args:
        journal: Of the server.
    """

    def __init__(self, journal: list[tuple[int, bytes, bytes | None]]) -> None:
        key, mark_key = FORMAT.key.encode(), keys.stamp(FORMAT.key).encode()
        self.commands: list[Write] = []
        self.stops: list[float] = []
        self.releases: list[float] = []
        self.gone: list[float] = []  # when the key of the stop held no stop any more
        self.arms: list[float] = []
        for place, (at_ns, name, value) in enumerate(journal):
            is_gone = value is None if name == keys.ESTOP_PRESSED.encode() else value is None or not _stops(value)
            if name.decode() in estop.KEYS and is_gone:
                self.gone.append(at_ns * 1e-9)
            if value is None:
                continue
            if name == key:
                after = journal[place + 1] if place + 1 < len(journal) else None
                is_marked = after is not None and after[:2] == (at_ns, mark_key)
                self.commands.append(_command(at_ns * 1e-9, value, after[2] if after and is_marked else None))
            elif name == keys.ESTOP_PRESSED.encode():
                self.stops.append(at_ns * 1e-9)
            elif name == keys.ESTOP.encode():
                (self.stops if _stops(value) else self.releases).append(at_ns * 1e-9)
                if b'"arm":true' in value:
                    self.arms.append(at_ns * 1e-9)
            elif name == keys.ARM.encode() and json.loads(value)["action"] == "arm":
                self.arms.append(at_ns * 1e-9)
        self._done = [write.done_s for write in self.commands]

    def since(self, begin_s: float, end_s: float) -> list[Write]:
        """Return the commands that were done in a span [s]."""
        return self.commands[bisect.bisect_left(self._done, begin_s) : bisect.bisect_right(self._done, end_s)]


def _stops(value: bytes) -> bool:
    """Whether a value of the stop's key asks for a stop: in doubt it does."""
    if value.strip() in (b"", b"0"):
        return False
    try:
        request = json.loads(value)
    except ValueError:
        return True
    return not (isinstance(request, dict) and request.get("stop") is False)


def _command(done_s: float, value: bytes, mark: bytes | None) -> Write:
    try:
        vector = codec.parse_json_vector(value, len(FORMAT.default))
    except codec.BadValue:
        vector = None
    found = stamp.decode(mark) if mark else None
    written_s = found.mono_ns * 1e-9 if found is not None and found.is_from_this_boot else None
    return Write(done_s, written_s, found.source if found is not None else FOREIGN, vector)


class Judge:
    """Goes through the ticks of a robot.

    Args:
        ticks: Of the robot.
        bus: What was written.
        disturbed: Spans in which the robot's server, its line or the bus was hindered, until some time after it [s].
        asked_past_bus: When a stop was asked for past the bus [s].
        is_told: Whether the bus tells of every write; else it is polled.
        is_real: Whether the robot needs arming.
    """

    def __init__(
        self,
        ticks: list[Tick],
        bus: Bus,
        disturbed: list[tuple[float, float]],
        asked_past_bus: list[float],
        *,
        is_told: bool,
        is_real: bool,
    ) -> None:
        self._ticks, self._bus, self._disturbed, self._asked_past_bus = ticks, bus, disturbed, asked_past_bus
        self._is_told, self._is_real = is_told, is_real
        self._instants = [tick.now_s for tick in ticks]

    def complaints(self) -> list[str]:
        """Return what does not hold, each with its instant."""
        return [
            f"at {tick.now_s:.4f} s, {before.state} -> {tick.state}: {what}"
            for rule in (
                self._rates,
                self._freshness,
                self._hands,
                self._blends,
                self._latched,
                self._after_a_release,
                self._arming,
            )
            for before, tick, what in rule()
        ] + list(self._each_stop())

    def _is_calm(self, begin_s: float, end_s: float) -> bool:
        return not any(begin_s <= end and begin <= end_s for begin, end in self._disturbed)

    def _rates(self) -> Iterator[Complaint]:
        """No element of the command moves faster than its rate, but where a released robot starts anew."""
        for before, tick in pairwise(self._ticks):
            most = FORMAT.rate * min(tick.now_s - before.now_s, LONGEST_TICK_S) + EPSILON
            if not _is_released(before, tick) and (np.abs(tick.vector - before.vector) > most).any():
                yield before, tick, "an element moves faster than its rate"

    def _freshness(self) -> Iterator[Complaint]:
        """Only what is in time moves the robot, and velocities end soon after the last of it."""
        blend = [FORMAT.default]  # where the present blend began, and what came of it until now
        idle_s = 0.0
        for before, tick in pairwise(self._ticks):
            usable = self._usable(tick.now_s)
            blend = [*blend, before.vector] if before.state == tick.state == "entering" else [before.vector]
            if tick.state == "stopped" or _is_released(before, tick):
                idle_s = 0.0
                continue
            if usable:
                idle_s = 0.0
                if not _within(tick.vector, [*blend, FORMAT.default, *(write.vector for write in usable)]):
                    yield before, tick, f"none of the {len(usable)} commands in time asks for this"
                continue
            idle_s += min(tick.now_s - before.now_s, COUNTED_S)
            if tick.state in FOLLOWS:
                yield before, tick, "follows, and no command is in time"
            if (np.abs(tick.vector - FORMAT.default) > np.abs(before.vector - FORMAT.default) + EPSILON).any():
                yield before, tick, "a joint moves away from standing, and no command is in time"
            if idle_s > FADE_S + LATE_TICK_S and tick.vector[list(FORMAT.velocities)].any():
                yield before, tick, f"velocities, {idle_s:.3f} s after the last command in time"

    def _hands(self) -> Iterator[Complaint]:
        """A robot that tracks one writer's commands tracks no other's before it has entered them."""
        obeyed = ""
        for before, tick in pairwise(self._ticks):
            if tick.state == "entering":
                obeyed = ""
            if tick.state == "tracking":
                usable = self._usable(tick.now_s)
                sources = {write.source for write in usable if np.array_equal(write.vector, tick.vector)}
                if len(sources) == 1 and obeyed not in ("", *sources):
                    yield before, tick, f"tracks {sources} in place of {obeyed} at once"
                obeyed = sources.pop() if len(sources) == 1 else obeyed

    def _blends(self) -> Iterator[Complaint]:
        """A command is entered with a blend of a second."""
        since_s = 0.0
        for before, tick in pairwise(self._ticks):
            if before.state != "entering":
                since_s = tick.now_s
            is_entered = tick.state == "tracking" and before.state not in ("tracking", "holding")
            if is_entered and tick.now_s - since_s < BLEND_S - EPSILON:
                yield before, tick, f"tracks a command {tick.now_s - since_s:.3f} s after it began to enter it"

    def _latched(self) -> Iterator[Complaint]:
        """A stop damps the joints until it is released, by a release that came after it was acted on."""
        stopped_s = 0.0
        for before, tick in pairwise(self._ticks):
            if before.state != "stopped" == tick.state:
                stopped_s = tick.now_s
            if tick.state == "stopped" and tick.record.sent.kp.any():
                yield before, tick, "stiff joints under a stop"
            if _is_released(before, tick):
                since_s = stopped_s - self._slack_s(stopped_s)
                if not any(since_s <= at_s <= tick.now_s for at_s in self._bus.releases):
                    yield before, tick, "a stop is left, and nobody has released it since it was acted on"

    def _after_a_release(self) -> Iterator[Complaint]:
        """Nothing is followed before commands have ceased."""
        released_s: float | None = None
        for before, tick in pairwise(self._ticks):
            if _is_released(before, tick):
                released_s = tick.now_s
            elif tick.state == "stopped":
                released_s = None
            if tick.state in FOLLOWS and released_s is not None:
                if not self._was_silent(released_s, tick.now_s):
                    yield before, tick, "follows a command that ran through the stop"
                released_s = None

    def _arming(self) -> Iterator[Complaint]:
        """What is disarmed stays so until somebody arms it; stiffness grows; nothing is sent before."""
        since_s = 0.0
        for before, tick in pairwise(self._ticks):
            sent = tick.record.sent
            if tick.arming == "disarmed" and (sent.kp.any() or sent.kd.any()):
                yield before, tick, "disarmed, and something is sent"
            if before.arming == "disarmed" != tick.arming and not (_is_released(before, tick) and not self._is_real):
                asked_s = before.now_s - self._slack_s(tick.now_s)
                if not any(asked_s <= at_s <= tick.now_s for at_s in self._bus.arms):
                    yield before, tick, "armed, and nobody asked for it"
            if before.arming == "disarmed" != tick.arming and before.state == tick.state == "stopped":
                yield before, tick, "armed under a stop"
            if before.arming != tick.arming:
                since_s = tick.now_s
            most = STIFFNESS * (tick.now_s - since_s) / RAMP_S + EPSILON
            if tick.arming == "arming" and (sent.kp > most).any():
                yield before, tick, f"stiffer than {tick.now_s - since_s:.2f} s of arming allow"
            if self._is_real and _is_released(before, tick) and tick.arming == "armed":
                yield before, tick, "a real robot is stiff as soon as its stop is released"

    def _each_stop(self) -> Iterator[str]:
        for at_s in self._bus.stops:
            is_traced = self._is_told or not any(0.0 <= gone_s - at_s < QUICK_S for gone_s in self._bus.gone)
            if is_traced and self._is_calm(at_s - 0.2, at_s + ACTED_S):
                yield from self._expect_stopped(at_s)
        for at_s in self._asked_past_bus:
            if self._is_calm(at_s - 0.2, at_s + ACTED_S):
                yield from self._expect_stopped(at_s)

    def _expect_stopped(self, at_s: float) -> Iterator[str]:
        first = bisect.bisect_left(self._instants, at_s)
        last = bisect.bisect_right(self._instants, at_s + ACTED_S)
        if first < 5 or last == len(self._ticks):
            return  # before the server ran, or at its end
        before = 0 if self._is_told else 1  # the same bytes again are no news to one that polls
        if not any(tick.state == "stopped" for tick in self._ticks[first - before : last]):
            yield f"the stop of {at_s:.4f} s is not acted on"

    def _slack_s(self, at_s: float) -> float:
        return QUICK_S if self._is_calm(at_s - 0.05, at_s) else 10.0

    def _usable(self, now_s: float) -> list[Write]:
        """Return the commands that a robot may follow at an instant: by both of their ages, where they have two."""
        is_calm = self._is_calm(now_s - 1.0, now_s)
        heard_s = HOLD_AFTER_S + QUICK_S if is_calm else 10.0
        return [
            write
            for write in self._bus.since(now_s - heard_s, now_s)
            if write.vector is not None
            and (write.written_s is None or now_s - write.written_s <= STALE_AFTER_S + EPSILON * 10)
        ]

    def _was_silent(self, since_s: float, until_s: float) -> bool:
        """Whether commands have ceased for long enough within a span [s]."""
        instants = [since_s, *(write.done_s for write in self._bus.since(since_s, until_s)), until_s]
        needed_s = SILENT_S - QUICK_S
        return any(after - before > needed_s for before, after in pairwise(instants))


def _is_released(before: Tick, tick: Tick) -> bool:
    return before.state == "stopped" != tick.state


def _within(vector: Floats, among: list[Floats]) -> bool:
    lower, upper = np.min(among, axis=0) - EPSILON, np.max(among, axis=0) + EPSILON
    return bool(((vector >= lower) & (vector <= upper)).all())
