"""An arm's recording, made of numbers: what its server and who commands it write."""

from __future__ import annotations

import numpy as np

from adapters.robots.kassow.names import KR810_ROBOT
from station.bus import codec, keys
from station.protocols import Floats
from tests.episode.synthetic import EpisodeBuilder

ROBOT = KR810_ROBOT
START = np.array([0.0, 0.35, 0.0, 1.6, 0.0, 1.19, 0.0])


def values(q: Floats, *, asked: Floats, gate: str = "tracking") -> dict[str, bytes]:
    """Return what stands on the bus while an arm is at q and asked to be elsewhere, by key."""
    return {
        keys.state_joints(ROBOT): codec.f64(np.concatenate([q, np.zeros(14)])),
        keys.command_used(ROBOT): codec.f64(asked),
        keys.command_gate(ROBOT): codec.json_object({"state": gate, "reason": "so"}),
        keys.policy_timing(ROBOT): codec.json_vector([0.0] * 8),
    }


def reach(builder: EpisodeBuilder, *, seconds: float = 1.0) -> None:
    """Record an arm that swings its joints, with a command that goes before it."""
    for number in range(round(seconds * 50)):
        swing = 0.3 * np.sin(0.1 * number + np.arange(7.0))
        gate = "entering" if number < 5 else "tracking"
        builder.write(values(START + swing, asked=START + swing + 0.02, gate=gate), at_s=0.02 * number, writer="kassow")
