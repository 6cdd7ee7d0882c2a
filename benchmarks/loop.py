"""Benchmark: how punctual a loop is."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from benchmarks import processes, stock
from benchmarks.harness import Benchmark, Rounds, Row, Settings, Target, alternate, compare, p50, p99
from station.life.loop import Rate, real_time

_HZ, _WORK_S = 50.0, 0.003
STOCK, PLAIN, FIFO = "relative sleep", "`Rate`", "`Rate`, FIFO"

METHOD = """\
A loop at 50 Hz with 3 ms of work per tick. Jitter: |time between two wake-ups - 20 ms|. Slowness: time taken for so
many ticks / their nominal time - 1, periods that were skipped included. *Loaded*: with a process of normal priority
beside it on every core. *FIFO*: after `real_time()`, which asks for SCHED_FIFO; left out where that is not permitted.
Baseline: `sleep(period - elapsed)`."""


def run(settings: Settings) -> list[Row]:
    """Measure."""
    seconds = settings.pick(6.0, 0.6)
    rows: list[Row] = []
    names = (STOCK, PLAIN, FIFO) if processes.fifo_is_permitted() else (STOCK, PLAIN)
    with contextlib.ExitStack() as stack:
        workers = {name: stack.enter_context(processes.Worker(pacer, name)) for name in names}
        for condition, beside in (("quiet", processes.nothing), ("loaded", processes.burners)):
            with beside():
                turns = {name: _turn(worker, seconds) for name, worker in workers.items()}
                rows += _rows(condition, alternate(turns, settings.rounds))
    return rows


@contextlib.contextmanager
def pacer(pacing: str) -> Iterator[Callable[[float], list[float]]]:
    """Pace a loop in this process; yields what runs it for so many seconds and returns its wake-up instants [s]."""
    if pacing == FIFO:
        real_time()
    yield lambda seconds: (_relative if pacing == STOCK else _absolute)(round(seconds * _HZ))


def _relative(ticks: int) -> list[float]:
    wakes: list[float] = []

    def tick() -> None:
        wakes.append(time.monotonic())
        processes.work(_WORK_S)

    stock.loop(_HZ, ticks, tick)
    return wakes


def _absolute(ticks: int) -> list[float]:
    wakes: list[float] = []
    rate = Rate(_HZ)
    for _ in range(ticks):
        rate.wait()
        wakes.append(time.monotonic())
        processes.work(_WORK_S)
    return wakes


def _turn(worker: processes.Worker, seconds: float) -> Callable[[], list[float]]:
    def measure() -> list[float]:
        wakes: list[float] = worker.ask(seconds)
        return wakes

    return measure


def _rows(condition: str, wakes: Mapping[str, Rounds]) -> list[Row]:
    jitter = {name: [_jitter_ms(w) for w in rounds] for name, rounds in wakes.items()}
    slow = {name: [[_slowness_percent(w)] for w in rounds] for name, rounds in wakes.items()}
    rows = []
    for name in [name for name in wakes if name != STOCK]:
        is_aimed_at = name == FIFO or condition == "quiet"  # without FIFO a loaded machine is not promised anything
        limit = Target(limit=0.15 if name == FIFO else 0.5) if is_aimed_at else None
        for what, unit, samples, by, target in (
            ("jitter p50", "ms", jitter, p50, None),
            ("jitter p99", "ms", jitter, p99, limit),
            ("slowness", "%", slow, p50, Target(limit=0.1) if is_aimed_at else None),
        ):
            rows.append(compare(f"{name}, {condition}: {what}", unit, samples[name], samples[STOCK],
                                baseline=STOCK, by=by, target=target))  # fmt: skip
    return rows


def _jitter_ms(wakes: object) -> list[float]:
    found: list[float] = (np.abs(np.diff(np.asarray(wakes)) - 1.0 / _HZ) * 1e3).tolist()
    return found


def _slowness_percent(wakes: object) -> float:
    instants = np.asarray(wakes)
    nominal_s = (len(instants) - 1) / _HZ
    return float(((instants[-1] - instants[0]) / nominal_s - 1.0) * 100.0)


BENCHMARK = Benchmark(name="loop", title="Loop jitter at 50 Hz", method=METHOD, run=run)
