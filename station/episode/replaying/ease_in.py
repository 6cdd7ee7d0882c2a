"""A blend into the first command of a replay: a robot must not be thrown into a pose.

From the default pose, where a robot without commands stands; from where it is, for an arm, which stays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from station import registry
from station.bus import codec, keys
from station.bus.client import Bus
from station.episode.reading.reader import EpisodeReader
from station.protocols import CommandFormat, Floats

_RATE_HZ = 50.0
_ARM_RAD_S = 0.2
"""Speed of the joint of an arm that has the farthest to go."""


_TOGETHER_NS = 500_000_000
"""What begins so soon after the first command begins with it."""


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
    known: list[CommandFormat] = [registry.find("command", name) for name in registry.names("command")]
    places = {form.key: form.default for form in known if form.key and not form.stays}
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
        if start is not None:  # else nobody drives that arm here
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
