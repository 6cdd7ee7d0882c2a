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
    blend = _blend(bus, reader, duration_s)
    if blend is None or duration_s <= 0.0:
        return 0.0
    steps = max(1, round(blend.duration_s * _RATE_HZ))
    began_ns = bus.clock.monotonic_ns()
    for step in range(steps):
        bus.clock.sleep_until(began_ns + round(step / _RATE_HZ * 1e9))
        vector = blend.start + (blend.goal - blend.start) * (step / steps)
        bus.publish({blend.key: codec.json_vector(vector)})
    bus.clock.sleep_until(began_ns + round(steps / _RATE_HZ * 1e9))
    return steps / _RATE_HZ


def _blend(bus: Bus, reader: EpisodeReader, duration_s: float) -> _Blend | None:
    known: list[CommandFormat] = [registry.find("command", name) for name in registry.names("command")]
    defaults = {form.key: form.default for form in known}
    arms = {key for key in reader.topics() if key.startswith(keys.action_joints(""))}
    for message in reader.messages({*defaults, *arms}):
        is_arm = message.topic in arms
        start = _where_it_is(bus, message.topic) if is_arm else defaults[message.topic]
        try:
            goal = codec.parse_json_vector(message.data, None if start is None else len(start))
        except codec.BadValue:
            continue  # the gate refuses it as it did then
        if start is None:  # nobody drives that arm here
            return None
        takes_s = float(np.abs(goal - start).max()) / _ARM_RAD_S if is_arm else 0.0
        return _Blend(message.topic, start, goal, max(duration_s, takes_s))
    return None


def _where_it_is(bus: Bus, key: str) -> Floats | None:
    """Return where an arm's server says that its arm is, shape (n,) [rad]; None where none says so."""
    data = bus.get(keys.command_used(key.removeprefix(keys.action_joints(""))))
    try:
        return None if data is None else codec.parse_f64(data)
    except codec.BadValue:
        return None
