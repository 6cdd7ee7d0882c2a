"""How far commands were from what the robot was asked for, at the moment somebody began to drive."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from tests.servers.g1_station import ROBOT, Log

_HALF_A_SECOND = 25  # steps


def jumps_at_engaging(log: Log) -> list[float]:
    """Return, for each engaging, how far the first command was from the one before it: from ours, or, where nobody
    commanded, from what the robot followed."""
    writes = [(place, write) for place, write in enumerate(list(log.writes)) if write.value is not None]
    commands = [(p, np.array(codec.parse_json(w.value or b""))) for p, w in writes if w.key == twist_keys.action_body()]
    used = [(p, codec.parse_f64(w.value or b"")) for p, w in writes if w.key == keys.command_used(ROBOT)]
    jumps, was_engaged = [], False
    for place, write in writes:
        if write.key != keys.command_source(ROBOT):
            continue
        is_engaged = bool(codec.parse_json(write.value or b"")["engaged"])
        if is_engaged and not was_engaged:  # the source comes after the command in their common write
            count = bisect_left(commands, place, key=lambda found: found[0])
            followed = used[: bisect_left(used, place, key=lambda found: found[0])]
            was_silent = count < 2 or commands[count - 2][0] < followed[-_HALF_A_SECOND][0]
            before = followed[-1][1] if was_silent else commands[count - 2][1]
            jumps.append(float(np.abs(commands[count - 1][1] - before).max()))
        was_engaged = is_engaged
    return jumps
