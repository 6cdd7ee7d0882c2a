"""Benchmark: the 250 Hz loop of an arm, from a heartbeat of the controller to the command that answers it."""

from __future__ import annotations

import contextlib
import importlib.util
import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from benchmarks import processes
from benchmarks.harness import Benchmark, Rounds, Row, Settings, Target, alternate, compare, mean
from station.life.loop import Rate, real_time

if TYPE_CHECKING:
    from station_kord import KordBridge

_HZ, _TICK_US = 250.0, 4000.0
_CALLS = 2000
PYTHON, PYTHON_FIFO = "loop in Python", "loop in Python, FIFO"
OURS, OURS_FIFO = "`KordBridge`", "`KordBridge`, FIFO"
BASELINES = {OURS: PYTHON, OURS_FIFO: PYTHON_FIFO}

METHOD = """\
The simulated controller ticks at 250 Hz of the wall clock; a target of one joint swings, written at 250 Hz by a thread
in Python, and another one computes without a pause, as servers do. *waitSync → send*: from the return of waitSync until
the command was handed over, measured in the loop. *Period*: how much longer than 4 ms the 99th percentile of the time
between two heartbeats is, as the loop saw them; ours to 20 µs, the width of its histogram there. Baseline: the same in
a thread of Python with absolute deadlines, which waits for its turn at the interpreter like every other. *Cost*: of one
call from Python, which never waits for the loop.
*Loaded*: a process of normal priority on every core. *FIFO*: the loop asks for SCHED_FIFO; left out where that is not
permitted. No controller and no network are in these figures. Left out where
`bridges/kord` is not built."""


class Seen(msgspec.Struct):
    """What one turn saw [µs]."""

    send_p50: float
    send_p99: float
    period_p99: float
    command: float = math.nan
    state: float = math.nan


def run(settings: Settings) -> list[Row]:
    """Measure."""
    if importlib.util.find_spec("station_kord") is None:
        return []
    seconds = settings.pick(5.0, 1.0)
    names = (PYTHON, OURS, *((PYTHON_FIFO, OURS_FIFO) if processes.fifo_is_permitted() else ()))
    rows: list[Row] = []
    with contextlib.ExitStack() as stack:
        workers = {name: stack.enter_context(processes.Worker(arm, name)) for name in names}
        for condition, beside in (("quiet", processes.nothing), ("loaded", processes.burners)):
            with beside():
                turns = {name: _turn(worker, seconds) for name, worker in workers.items()}
                rows += _rows(condition, alternate(turns, settings.rounds))
    return rows


@contextlib.contextmanager
def arm(name: str) -> Iterator[Callable[[float], Seen]]:
    """Drive a simulated arm in this process; yields what does so for so many seconds."""
    if name == PYTHON_FIFO:
        real_time()

    def act(seconds: float) -> Seen:
        stop = threading.Event()
        busy = threading.Thread(target=_compute, args=(stop,))
        busy.start()
        try:
            with _connected(70 if name == OURS_FIFO else 0) as bridge:
                seen = _drive(bridge, seconds)
                if name in BASELINES.values():
                    return seen
                state = bridge.get_state()
                send, period_us = state.sync_to_send_us, state.period_us.p99 - _TICK_US
                return Seen(send.p50, send.p99, period_us, _cost_us(_command(bridge)), _cost_us(bridge.get_state))
        finally:
            stop.set()
            busy.join()

    yield act


def _compute(stop: threading.Event) -> None:
    while not stop.is_set():
        np.sin(np.arange(2000.0)).sum()


def _connected(priority: int) -> KordBridge:
    from station_kord import KordBridge, Limits, SimOptions

    sim = SimOptions(late_fault_ticks=1_000_000, watchdog_ticks=1_000_000)  # late is what is measured here, not a fault
    limits = Limits(q_min=sim.q_min, q_max=sim.q_max, qd_max=(2.0,) * 7, qdd_max=(10.0,) * 7)
    bridge = KordBridge(limits=limits, sim=sim, real_time_priority=priority)
    bridge.connect()
    bridge.engage()
    return bridge


def _drive(bridge: KordBridge, seconds: float) -> Seen:
    """Write a swinging target at 250 Hz; return how a loop in this very thread would have kept its time."""
    rate, took_us, wakes_us = Rate(_HZ), [], []
    q = bridge.get_state().q
    for tick in range(round(seconds * _HZ)):
        rate.wait()
        woke_ns = time.monotonic_ns()
        target = q.copy()
        target[0] += 0.05 * math.sin(0.01 * tick)
        bridge.stream_j(target)
        took_us.append((time.monotonic_ns() - woke_ns) * 1e-3)
        wakes_us.append(woke_ns * 1e-3)
    p50, p99 = np.percentile(took_us, (50, 99))
    return Seen(float(p50), float(p99), float(np.percentile(np.diff(wakes_us), 99)) - _TICK_US)


def _command(bridge: KordBridge) -> Callable[[], None]:
    q = bridge.get_state().q_target
    return lambda: bridge.stream_j(q)


def _cost_us(call: Callable[[], object]) -> float:
    """Return the median time of a call while nothing else holds the interpreter for long."""
    took_ns = []
    for _ in range(_CALLS):
        began_ns = time.perf_counter_ns()
        call()
        took_ns.append(time.perf_counter_ns() - began_ns)
    return float(np.median(took_ns)) * 1e-3


def _turn(worker: processes.Worker, seconds: float) -> Callable[[], Seen]:
    return lambda: worker.ask(seconds)


def _rows(condition: str, taken: dict[str, list[Seen]]) -> list[Row]:
    def of(name: str, field: str) -> Rounds:
        return [[getattr(seen, field)] for seen in taken[name]]

    rows = []
    for name in [name for name in BASELINES if name in taken]:
        label, baseline = f"{name}, {condition}", BASELINES[name]
        for what, field, target in (
            ("waitSync → send, p50", "send_p50", Target(limit=100.0)),
            ("waitSync → send, p99", "send_p99", None),
            ("period, p99", "period_p99", None),
        ):
            rows.append(compare(f"{label}: {what}", "µs", of(name, field), of(baseline, field),
                                baseline=baseline, by=mean, target=target))  # fmt: skip
        for what, field in (("stream_j", "command"), ("get_state", "state")):
            rows.append(compare(f"{label}: cost of {what}", "µs", of(name, field), by=mean))
    return rows


BENCHMARK = Benchmark(name="kord", title="The arm's loop", method=METHOD, run=run)
