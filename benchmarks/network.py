"""The policy's network as one call, so that loops carry the load that they carry in earnest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks import processes, upstream
from station import assets, registry
from station.errors import AssetMissing

_STAND_IN_S = 0.0005


def step() -> Callable[[], object]:
    """Return one inference of TWIST2's network or, without upstream data, about as much work."""
    try:
        checkpoint = assets.resolve(upstream.CHECKPOINT)
    except AssetMissing:
        return lambda: processes.work(_STAND_IN_S)
    policy = registry.find("policy", "twist2")(checkpoint)
    observation = np.zeros(policy.spec.observation_size, dtype=np.float32)
    return lambda: policy.act(observation)
