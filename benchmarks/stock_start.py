"""A stock simulation script from its first import to its first state on the bus; run by the benchmark of the start."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import redis

from benchmarks import stock


def main(port: int, model: Path, checkpoint: Path) -> None:
    """Load everything, take one step, write the state."""
    client = redis.Redis(host="localhost", port=port, db=0)
    zeros = np.zeros(29)
    simulation = stock.Simulation(model, checkpoint, zeros, zeros, zeros, zeros)
    simulation.run([np.zeros(35)])
    client.set(stock.STATE_KEY, json.dumps([0.0] * 34))


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]))
