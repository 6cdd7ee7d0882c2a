"""What an arm's session with its controller counted: heartbeats, targets sent in motion and at hold, lateness, faults.

Rates are differences of counters over the writer's time. A span of a fifth of a second counts as motion where nine of
ten targets in it differ from the one before (now and then a tick meets no new command), as hold where none does. It
counts as neither where some do, and right after motion, where its last target may still be on its way.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from station.bus import arm_contracts, codec, keys
from station.episode.quality.finding_parts import ArmQuality
from station.episode.reading.messages import Message
from station.protocols import Floats

_SPAN_NS = 200_000_000
_MOVING = 0.9
_SETTLED_S = 0.4  # from the end of a motion until a hold is one
_NAMES = (*arm_contracts.COUNTERS, *arm_contracts.SESSION_TIMES)


def robots(topics: Iterable[str]) -> list[str]:
    """Return the suffixes of the arms whose counters are among the topics, sorted."""
    prefix = keys.state_counters("")
    return sorted(topic.removeprefix(prefix) for topic in topics if topic.startswith(prefix))


@dataclass
class _Rate:
    """How many targets were sent in how long."""

    sends: float = 0.0
    seconds: float = 0.0

    @property
    def hz(self) -> float | None:
        return self.sends / self.seconds if self.seconds > 0 else None


@dataclass
class ArmMeter:
    """Takes the messages of one arm and tells at the end what its session was like."""

    robot: str
    _first: tuple[int, Floats] | None = None
    _last: tuple[int, Floats] | None = None
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

    def feed(self, message: Message) -> None:
        """Take a message; those of other keys are passed over."""
        if message.channel.is_deletion:
            return
        if message.topic == keys.target(self.robot):
            self._targets += 1
            self._moved += message.data != self._target
            self._target = message.data
        elif message.topic == keys.state_controller(self.robot):
            self._take_word(message.data)
        elif message.topic == keys.state_counters(self.robot) and len(message.data) == 8 * len(_NAMES):
            self._take_counters(message.publish_ns, codec.parse_f64(message.data))

    def result(self) -> ArmQuality | None:
        """Return what the session was like; None where nothing was counted."""
        if self._first is None or self._last is None:
            return None
        last = dict(zip(_NAMES, self._last[1].tolist(), strict=True))
        grown = dict(zip(_NAMES, (self._last[1] - self._first[1]).tolist(), strict=True))
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

    def _take_counters(self, at_ns: int, values: Floats) -> None:
        if self._last is not None and (values < self._last[1])[: len(arm_contracts.COUNTERS)].any():
            self._first = self._span = None  # another session: its server was started again
        self._last = (at_ns, values)
        self._first = self._first or self._last
        if self._span is None:
            self._span, self._targets, self._moved = self._last, 0, 0
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

    def _take_word(self, data: bytes) -> None:
        try:
            word = codec.parse_json(data)
        except codec.BadValue:  # a stranger's; the counters say the rest
            return
        if isinstance(word, dict):
            self._backend = str(word.get("backend", ""))[:40]
            profile = str(word.get("profile", ""))[:40]
            if profile and profile not in self._profiles and len(self._profiles) < 10:
                self._profiles.append(profile)


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
