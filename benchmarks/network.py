"""The policy's network as one call, so that loops carry the load that they carry in earnest."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks import processes

_REFERENCE = "twist2:ckpts/twist2_1017_20k.onnx"
_STAND_IN_S = 0.0005


def step() -> Callable[[], object]:
    """Return one inference of TWIST2's network or, without upstream data, about as much work."""
    folder = os.environ.get("STATION_ASSETS")
    if not folder or not Path(folder).is_dir():
        return lambda: processes.work(_STAND_IN_S)
    from station import assets, registry

    policy = registry.find("policy", "twist2")(assets.resolve(_REFERENCE))
    observation = np.zeros(policy.spec.observation_size, dtype=np.float32)
    return lambda: policy.act(observation)
