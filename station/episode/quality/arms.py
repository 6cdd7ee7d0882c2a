"""What an arm's session with its controller counted: heartbeats, targets sent in motion and at hold, lateness, faults.

Counters are those of a session and begin at 0 with it. What the session counted that the episode begins in is told by
differences; of sessions that began later, because the server was started again, by all that they counted, and the sum
is what counts. Of their latencies the greatest is told.

Rates are differences of counters over the writer's time. A span of a fifth of a second counts as motion where nine of
ten targets in it differ from the one before (now and then a tick meets no new command), as hold where none does. It
counts as neither where some do, and right after motion, where its last target may still be on its way.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from station.bus import codec, keys, robot_streams
from station.episode.quality.finding_parts import ArmQuality
from station.episode.reading.messages import Message
from station.protocols import Floats

_SPAN_NS = 200_000_000
_MOVING = 0.9
_SETTLED_S = 0.4  # from the end of a motion until a hold is one
_NAMES = (*robot_streams.COUNTERS, *robot_streams.SESSION_TIMES)
_COUNTERS = len(robot_streams.COUNTERS)
_LARGEST = float(1 << 53)  # what counts to more than that in a double counts nothing


def robots(topics: Iterable[str]) -> list[str]:
    """Return the suffixes of the arms whose counters are among the topics, sorted."""
    prefix = keys.state_counters("")
    own = (topic for topic in topics if topic.startswith(prefix) and not keys.is_stamp(topic))
    return sorted(topic.removeprefix(prefix) for topic in own)


@dataclass
class _Rate:
    """How many targets were sent in how long."""

    sends: float = 0.0
    seconds: float = 0.0

    @property
    def hz(self) -> float | None:
        return self.sends / self.seconds if self.seconds > 0 else None


@dataclass
class _Sessions:
    """What the sessions of one process counted, one after the other.

    Attributes:
        since: Counters of the present one when the episode, or it, began, shape (11,).
        newest: Newest counters and latencies of the present one, shape (19,).
        counted, times: Of those that are over: what they counted within the episode, shape (11,), and their greatest
            latencies, shape (8,) [s]; NaN where none was told.
    """

    since: Floats
    newest: Floats
    counted: Floats = field(default_factory=lambda: np.zeros(_COUNTERS))
    times: Floats = field(default_factory=lambda: np.full(len(_NAMES) - _COUNTERS, np.nan))

    def update(self, values: Floats) -> bool:
        """Add the newest counters and latencies; return whether another session has begun."""
        is_another = bool((values < self.newest)[:_COUNTERS].any())
        if is_another:
            self.counted, self.times = self.total()
            self.since = np.zeros(_COUNTERS)
        self.newest = values
        return is_another

    def total(self) -> tuple[Floats, Floats]:
        """Return what all of them counted, and the greatest of their latencies."""
        counters, times = self.newest[:_COUNTERS], self.newest[_COUNTERS:]
        return self.counted + (counters - self.since), np.fmax(self.times, times)


@dataclass
class ArmMeter:
    """Takes the messages of one arm and tells at the end what its sessions were like."""

    robot: str
    _sessions: dict[str, _Sessions] = field(default_factory=dict)  # by the process that has them
    _source: str = ""  # the newest of them
    _span: tuple[int, Floats] | None = None  # where the present span began
    _targets: int = 0
    _moved: int = 0
    _target: bytes = b""
    _settled_s: float = 0.0
    _in_motion: _Rate = field(default_factory=_Rate)
    _at_hold: _Rate = field(default_factory=_Rate)
    _ticks: _Rate = field(default_factory=_Rate)
    _profiles: list[str] = field(default_factory=list)
    _backend: str = ""

    @property
    def topics(self) -> set[str]:
        """The keys that it wants to be fed."""
        return {family(self.robot) for family in (keys.target, keys.state_controller, keys.state_counters)}

    def feed(self, message: Message) -> None:
        """Add a message; those of other keys are passed over."""
        if message.channel.is_deletion:
            return
        if message.topic == keys.target(self.robot):
            self._targets += 1
            self._moved += message.data != self._target
            self._target = message.data
        elif message.topic == keys.state_controller(self.robot):
            self._add_session(message.data)
        elif message.topic == keys.state_counters(self.robot) and len(message.data) == 8 * len(_NAMES):
            values = codec.parse_f64(message.data)
            if ((values >= 0) & (values <= _LARGEST))[:_COUNTERS].all():
                self._add_counters(message.channel.source, message.publish_ns, values)

    def result(self) -> ArmQuality | None:
        """Return what the sessions were like; None where nothing was counted."""
        if not self._sessions:
            return None
        counts, times = zip(*(sessions.total() for sessions in self._sessions.values()), strict=True)
        grown = dict(zip(robot_streams.COUNTERS, np.sum(counts, axis=0).tolist(), strict=True))
        last = dict(zip(robot_streams.SESSION_TIMES, np.fmax.reduce(times).tolist(), strict=True))
        counted = ("late_commands", "sync_timeouts", "missed_ticks", "limit_refusals", "commands_dropped_by_throttle")
        return ArmQuality(
            robot=self.robot,
            backend=self._backend,
            profiles=list(self._profiles),
            sync_hz=self._ticks.hz,
            sends=int(grown["stream_j_sends"]),
            sends_moving_hz=self._in_motion.hz,
            moving_s=self._in_motion.seconds,
            sends_holding_hz=self._at_hold.hz,
            holding_s=self._at_hold.seconds,
            faults=int(grown["fault_count"]),
            **{name: int(grown[name]) for name in counted},
            sync_to_send_p50_s=_known(last["sync_to_send_p50"]),
            sync_to_send_p99_s=_known(last["sync_to_send_p99"]),
            sync_to_send_max_s=_known(last["sync_to_send_max"]),
            period_p99_s=_known(last["period_p99"]),
            period_max_s=_known(last["period_max"]),
        )

    def _add_counters(self, source: str, at_ns: int, values: Floats) -> None:
        sessions = self._sessions.get(source)
        if sessions is None:  # the first may have counted before the episode began
            since = np.zeros(_COUNTERS) if self._sessions else values[:_COUNTERS]
            sessions = self._sessions[source] = _Sessions(since, values)
        is_another = sessions.update(values) or source != self._source
        self._source = source
        if is_another or self._span is None:
            self._span, self._targets, self._moved = (at_ns, values), 0, 0
        elif at_ns - self._span[0] >= _SPAN_NS:
            self._close_span(at_ns, values)

    def _close_span(self, at_ns: int, values: Floats) -> None:
        assert self._span is not None
        seconds, grown = (at_ns - self._span[0]) * 1e-9, values - self._span[1]
        self._ticks.seconds += seconds
        self._ticks.sends += float(grown[_NAMES.index("tick")])
        is_motion = self._moved > _MOVING * self._targets
        self._settled_s = 0.0 if self._moved else self._settled_s + seconds
        rate = self._in_motion if is_motion else self._at_hold if self._settled_s > _SETTLED_S else None
        if rate is not None:
            rate.seconds += seconds
            rate.sends += float(grown[_NAMES.index("stream_j_sends")])
        self._span, self._targets, self._moved = (at_ns, values), 0, 0

    def _add_session(self, data: bytes) -> None:
        if not (word := codec.parse_facts(data)):  # not one of ours; the counters say the rest
            return
        self._backend = str(word.get("backend", ""))[:40]
        profile = str(word.get("profile", ""))[:40]
        if profile and profile not in self._profiles and len(self._profiles) < 10:
            self._profiles.append(profile)


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
