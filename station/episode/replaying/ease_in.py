"""A blend from the default pose into the first command of a replay: a robot must not be thrown into a pose."""

from __future__ import annotations

import time

from station import registry
from station.bus import codec
from station.bus.client import Bus
from station.episode.reading.reader import EpisodeReader
from station.life.loop import sleep_until
from station.protocols import CommandFormat, Floats

_RATE_HZ = 50.0


def ease_in(bus: Bus, reader: EpisodeReader, duration_s: float) -> float:
    """Send a blend into the first whole-body command of an episode; return its length [s], 0 when there is none.

    Args:
        bus: Where to.
        reader: The episode.
        duration_s: Length of the blend [s].
    """
    first = _first_command(reader)
    if first is None or duration_s <= 0.0:
        return 0.0
    form, goal = first
    steps = max(1, round(duration_s * _RATE_HZ))
    began_ns = time.monotonic_ns()
    for step in range(steps):
        sleep_until(began_ns + round(step / _RATE_HZ * 1e9))
        vector = form.default + (goal - form.default) * (step / steps)
        bus.publish({form.key: codec.json_vector(vector)})
    sleep_until(began_ns + round(steps / _RATE_HZ * 1e9))
    return steps / _RATE_HZ


def _first_command(reader: EpisodeReader) -> tuple[CommandFormat, Floats] | None:
    known: list[CommandFormat] = [registry.find("command", name) for name in registry.names("command")]
    forms = {form.key: form for form in known}
    for message in reader.messages(set(forms)):
        form = forms[message.topic]
        try:
            return form, codec.parse_json_vector(message.data, len(form.default))
        except codec.BadValue:
            continue  # the gate refuses it as it did then
    return None
