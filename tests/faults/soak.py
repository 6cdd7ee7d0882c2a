"""``make soak``: a whole station for an hour, under load, with something broken every ten seconds.

A robot walks, a recorder records, load runs; processes are killed and frozen, lines cut, the bus stopped, the robot
stopped, at random. Each minute is an episode of its own, in which afterwards every write is looked for. A line per
fault goes to stderr, the figures as JSON to stdout; the exit code is 1 when a robot fell or a write is missing, twice
or wrong, unless its writer knows that the bus never took it, or the manifest tells of it: as dropped, or as a hole that
`station check` rejects (what died with a killed bus, or came faster than such a machine could catch up with).
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.errors import BusError
from tests.faults.control_trials import CLIPS
from tests.faults.moving_station import MovingStation
from tests.faults.soak_load import Load, account
from tests.faults.station_faults import FAULTS, KILLS_THE_BUS, Fault
from tests.waiting import wait_until

WEIGHTS = {"kill recorder": 3, "kill motion": 2, KILLS_THE_BUS: 0.5}
PROGRESS = "{at:7.0f} s  {name:<22} {reaction}\n"


class Soak:
    """One long run; `figures` holds what came of it, `kept` the episodes that want to be looked into."""

    def __init__(self, station: MovingStation, seed: int, every_s: float, load: dict[str, float], kept: Path) -> None:
        self.kept = kept
        self.station, self.random, self.every_s, self.load = station, Random(seed), every_s, load
        self.faults: Counter[str] = Counter()
        self.reactions: dict[str, list[float]] = {}
        self.sums: Counter[str] = Counter()
        self.verdicts: Counter[str] = Counter()
        self.began_s = time.monotonic()

    def episode(self, seconds: float) -> None:
        """Record one, break things meanwhile, and look for every write."""
        folder = Path(self.station.ask("start", task="soak").path or "")
        load, done = Load(self.station.address, **self.load), Counter[str]()
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.station.wait_s(self.random.uniform(0.5, 2.0 * self.every_s - 0.5))
            done[self.break_something()] += 1
        written = load.stop()
        wait_until(self.is_recording, 60.0)
        self.station.ask("stop")
        if self.look_at(folder, written, done):
            shutil.rmtree(folder)
        else:  # to be looked into: what the file and the manifest say of it
            self.kept.mkdir(parents=True, exist_ok=True)
            shutil.move(folder, self.kept)
            sys.stderr.write(f"          kept as {self.kept / folder.name}\n")

    def break_something(self) -> str:
        """Do one fault, and wait until the robot follows commands again."""
        names = list(FAULTS)
        name = self.random.choices(names, [WEIGHTS.get(name, 1) for name in names])[0]
        fault: Fault = FAULTS[name]
        at_s = time.monotonic() - self.began_s
        reaction_s = fault(self.station, self.random)
        self.faults[name] += 1
        if reaction_s is not None:
            self.reactions.setdefault(name, []).append(reaction_s)
        sys.stderr.write(
            PROGRESS.format(at=at_s, name=name, reaction="" if reaction_s is None else f"{reaction_s:.3f} s")
        )
        return name

    def is_recording(self) -> bool:
        """Whether the recorder is there, after whatever befell it."""
        try:
            health = self.station.health("recorder")
        except BusError:
            return False
        return health is not None and health.is_alive and health.state == "active"

    def look_at(self, folder: Path, written: dict[str, tuple[int, int]], done: Counter[str]) -> bool:
        """Count what an episode holds, and what `check` says of it; return whether all is well."""
        reader = open_episode(folder)
        found, quality = account(reader, written), check(reader)
        has_hole = bool(reader.manifest.holes) or KILLS_THE_BUS in done
        self.sums["episodes"] += 1
        self.sums["written"] += sum(count for count, _ in written.values())
        self.sums.update({name: found[name] for name in ("messages", "twice", "wrong", "refused", "dropped")})
        lost = max(0, found["missing"] - found["refused"] - found["dropped"])
        self.sums["lost in holes that were told" if has_hole else "lost"] += lost
        is_hidden = lost > 0 and quality.verdict != "reject"
        self.sums["holes not told"] += is_hidden
        self.sums["recorder restarts"] += len(reader.manifest.recovery)
        self.verdicts[quality.verdict] += 1
        sys.stderr.write(f"          {folder.name}: {quality.verdict}, {found}\n")
        return not (is_hidden or found["twice"] or found["wrong"] or (lost and not has_hole))

    def figures(self) -> dict[str, Any]:
        """Return what came of it."""
        return {
            "seconds": round(time.monotonic() - self.began_s),
            "faults": dict(sorted(self.faults.items())),
            "falls": self.station.falls(),
            "worst_lean_deg": round(self.station.worst_lean_deg(), 1),
            "reaction_s": {name: _spread(values) for name, values in sorted(self.reactions.items())},
            "verdicts": dict(self.verdicts),
            **self.sums,
        }

    @property
    def has_failed(self) -> bool:
        """Whether something came out that must not."""
        return self.station.falls() > 0 or any(self.sums[name] for name in ("lost", "twice", "wrong", "holes not told"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run."""
    parser = argparse.ArgumentParser(prog="python -m tests.faults.soak", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--every", type=float, default=10.0, metavar="SECONDS", help="between two faults, on average")
    parser.add_argument("--per-s", type=float, default=10_000.0, help="small values a second")
    parser.add_argument("--keep", type=Path, default=Path("soak"), metavar="DIR", help="for episodes gone wrong")
    parser.add_argument("--mb-per-s", type=float, default=30.0, help="pictures")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="soak-") as name:
        os.environ["XDG_RUNTIME_DIR"] = os.environ["XDG_STATE_HOME"] = name
        load = {"per_s": options.per_s, "mb_per_s": options.mb_per_s}
        with MovingStation(Path(name)) as station:
            soak = Soak(station, options.seed, options.every, load, options.keep)
            station.play(soak.random.choice(CLIPS))
            end_s = time.monotonic() + 60.0 * options.minutes
            while time.monotonic() < end_s:
                soak.episode(min(60.0, 60.0 * options.minutes))
            sys.stdout.write(json.dumps(soak.figures()) + "\n")
            return int(soak.has_failed)


def _spread(values: Sequence[float]) -> dict[str, float]:
    named = {"p50": np.percentile(values, 50), "p99": np.percentile(values, 99), "max": max(values)}
    return {name: round(float(value), 3) for name, value in named.items()}


if __name__ == "__main__":
    sys.exit(main())
