"""``python -m tests.faults.soak_control --runs 20 --seed 1``: faults of the control side, at random moments of random
clips; a line of JSON per kind of fault, with what the robot did."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from tests.faults.control_trials import CLIPS, KINDS, Kind, Trial, random_trial
from tests.faults.moving_station import MovingStation


def soak(kind: Kind, runs: int, seed: int, folder: Path, clips: Sequence[str] = CLIPS) -> dict[str, Any]:
    """Do so many trials of a kind in one station; return the figures."""
    random = Random(f"{seed} {kind}")
    trials = []
    with MovingStation(folder, record=False) as station:
        for _ in range(runs):
            trials.append(random_trial(station, kind, random, clips=clips))
            sys.stderr.write(f"{trials[-1]}\n")
    return figures(kind, trials)


def figures(kind: Kind, trials: Sequence[Trial]) -> dict[str, Any]:
    """Sum trials of a kind up."""
    found: dict[str, Any] = {
        "kind": kind,
        "runs": len(trials),
        "clips": len({trial.clip for trial in trials}),
        "falls": sum(trial.falls for trial in trials),
        "worst_lean_deg": round(max(trial.lean_deg for trial in trials), 1),
        "lowest_pelvis_m": round(min(trial.lowest_m for trial in trials), 3),
        "command_rate_of_limit": round(max(trial.rate for trial in trials), 3),
        "away_s": _spread([trial.away_s for trial in trials], 1.0),
        "followed_age_max_ms": _spread([trial.used_age_s for trial in trials], 1e3),
        "age_at_hold_ms": _spread([trial.hold_age_s for trial in trials], 1e3),
        "fault_to_hold_ms": _spread([trial.hold_s for trial in trials], 1e3),
        "last_command_to_standing_s": _spread([trial.default_s for trial in trials], 1.0),
        "end_of_fault_to_following_s": _spread([trial.entered_s for trial in trials], 1.0),
    }
    return {name: value for name, value in found.items() if value is not None}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run; return 0 when no robot fell."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults.soak_control", description=__doc__)
    parser.add_argument("--runs", type=int, default=20, help="trials of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--clips", nargs="+", choices=CLIPS, default=list(CLIPS))
    options = parser.parse_args(arguments)
    falls = 0
    for kind in options.kinds:
        with tempfile.TemporaryDirectory(prefix="soak-") as name:
            os.environ["XDG_RUNTIME_DIR"] = os.environ["XDG_STATE_HOME"] = name
            os.chmod(name, 0o700)
            found = soak(kind, options.runs, options.seed, Path(name), options.clips)
        sys.stdout.write(json.dumps(found) + "\n")
        sys.stdout.flush()
        falls += found["falls"]
    return int(falls > 0)


def _spread(values: Sequence[float], scale: float) -> dict[str, float] | None:
    known = np.array([value * scale for value in values if not math.isnan(value)])
    if not known.any():
        return None
    return {
        "p50": round(float(np.percentile(known, 50)), 3),
        "p99": round(float(np.percentile(known, 99)), 3),
        "max": round(float(known.max()), 3),
    }


if __name__ == "__main__":
    sys.exit(main())
