"""Benchmark: what a whole station takes of a machine while a simulated robot follows a motion."""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from adapters.robots.g1 import twist_keys
from benchmarks import processes, sim, stock, upstream
from benchmarks.harness import Benchmark, Row, Settings, Target, alternate, compare
from station import assets
from station.bus.address import BusAddress

_SETTLE_S = 3.0

METHOD = """\
The programs of `station up g1-sim-motion --record` (supervisor, bus, G1, motion, recorder), with what stock loads,
while the robot follows a motion: processor time over 20 s, and then memory, each page shared out among those that have
it (PSS). Baseline: stock's three programs and their bus: a simulation at 50 Hz that steps 1 ms of physics at a time
with PD in numpy before each, what writes its commands, and a recorder that polls at 30 Hz and keeps what it sees;
without torch, viewer and cameras, to its advantage."""


class _Use(NamedTuple):
    """Memory [MB], and processor time per time [%] of one core."""

    memory_mb: float
    cpu_percent: float


def run(settings: Settings) -> list[Row]:
    """Measure."""
    seconds = settings.pick(20.0, 2.0)
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        folder, baseline = Path(name), "stock, three programs"
        _ours(folder, 0.0)  # fills the cache
        taken = alternate(
            {"ours": lambda: _ours(folder, seconds), baseline: lambda: _theirs(seconds)}, min(settings.rounds, 3)
        )
    ours, theirs = taken["ours"], taken[baseline]
    return [
        compare("memory", "MB", [[use.memory_mb] for use in ours], [[use.memory_mb] for use in theirs],
                baseline=baseline, target=Target(limit=250.0)),
        compare("processor time", "% of a core", [[use.cpu_percent] for use in ours],
                [[use.cpu_percent] for use in theirs], baseline=baseline, target=Target(limit=35.0)),
    ]  # fmt: skip


def _ours(folder: Path, seconds: float) -> _Use:
    arguments = ["up", "g1-sim-motion", "--yes", "--record", "--task", "bench", "--data", str(folder / "data")]
    arguments += ["--set", f"motion.motion={assets.resolve(upstream.MOTION)}", "--set", "motion.loop=true"]
    arguments += upstream.settings("g1.")
    environment = processes.own_station(folder) | {"XDG_CACHE_HOME": str(folder)}
    address = BusAddress(socket=str(folder / "run" / "station" / "bus.sock"))
    with processes.station(*arguments, environment=environment, log=folder / "station.log") as process:
        processes.until(lambda: processes.gate_state(address, twist_keys.TWIST2_ROBOT) == "tracking")
        return _measured(processes.family(process.pid), seconds)


def _theirs(seconds: float) -> _Use:
    with _stock() as pids:
        return _measured(pids, seconds)


@contextlib.contextmanager
def _stock() -> Iterator[Sequence[int]]:
    """Run stock's programs and their bus; yields their processes when the robot has begun to move."""
    names = (*stock.COMMAND_KEYS, twist_keys.T_ACTION, twist_keys.T_STATE, stock.STATE_KEY)
    commands = sim.motion_commands(sim.stock_motion())
    with (
        processes.bus(is_fifo=False) as (address, port),
        processes.Beside(stock.command, port, commands),
        processes.Beside(stock.simulate, port, sim.stock_constants()),
        processes.Beside(stock.record, port, names),
    ):
        processes.until(lambda: processes.has_key(address, stock.STATE_KEY))
        yield processes.family(os.getpid())[1:]


def _measured(pids: Sequence[int], seconds: float) -> _Use:
    time.sleep(_SETTLE_S if seconds else 0.0)
    began_s, began_cpu_s = time.monotonic(), sum(map(processes.cpu_s, pids))
    time.sleep(seconds)
    cpu_s, elapsed_s = sum(map(processes.cpu_s, pids)) - began_cpu_s, time.monotonic() - began_s
    return _Use(sum(map(processes.shared_out_mb, pids)), 100.0 * cpu_s / elapsed_s)


BENCHMARK = Benchmark(name="whole", title="A whole station", method=METHOD, run=run, needs_assets=True)
