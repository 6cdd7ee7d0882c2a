"""Benchmark: what the recorder costs the policy loop beside it."""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np

from adapters.robots.g1 import twist_keys
from benchmarks import commands, processes, traffic, upstream
from benchmarks.harness import Benchmark, Rounds, Row, Settings, Target, alternate, compare, p50, p99
from benchmarks.recorded import recorder, wait_active
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.contract import TIMING_STAGES
from station.episode.recorder import remote

_SMALL_PER_S, _IMAGE_MB_PER_S, _COMMAND_HZ = 1_000.0, 30.0, 100.0
_SETTLE_S = 1.0

METHOD = """\
The real G1 server (TWIST2's model at 1 ms and its network, gate) at 50 Hz, commands at 100 Hz and 1,000 small values a
second beside it; with pictures, 30 MB/s too. The recorder process is started and recording in one turn and absent in
the next. *Wake-up*: |time between two ticks - 20 ms|; *cycle*: from reading the state to the targets being sent; both
from `policy_timing`. *FIFO*: the server under SCHED_FIFO, as it asks for; left out where that is not permitted.
Baseline: the same without the recorder."""


class Seen(msgspec.Struct):
    """What the loop did in a round [ms]."""

    wake_ms: list[float]
    cycle_ms: list[float]


def run(settings: Settings) -> list[Row]:
    """Measure."""
    rows = []
    priorities = (0, 50) if processes.fifo_is_permitted() else (0,)
    for priority in priorities:
        for image_mb_per_s in (0.0, _IMAGE_MB_PER_S):
            rows += _rows(settings, priority, image_mb_per_s)
    return rows


def _rows(settings: Settings, priority: int, image_mb_per_s: float) -> list[Row]:
    seconds = settings.pick(8.0, 2.0)
    with _station(priority, image_mb_per_s) as (address, folder):
        taken = alternate(
            {"on": lambda: _with_recorder(address, folder, seconds), "off": lambda: _watch(address, seconds)},
            settings.rounds,
        )

    def of(name: str, field: str) -> Rounds:
        return [getattr(seen, field) for seen in taken[name]]

    label = ("FIFO" if priority else "normal") + (", pictures" if image_mb_per_s else "")
    wake_limit = (1.2 if image_mb_per_s else 1.1) if priority else 1.5
    rows = []
    for what, field, by, limit in (
        ("wake-up p50", "wake_ms", p50, None),
        ("wake-up p99", "wake_ms", p99, wake_limit),
        ("cycle p50", "cycle_ms", p50, None),
        ("cycle p99", "cycle_ms", p99, wake_limit),
    ):
        target = None if limit is None else Target(limit=limit, of="ratio")
        rows.append(compare(f"{label}: {what} with the recorder", "ms", of("on", field), of("off", field),
                            baseline="without", by=by, target=target))  # fmt: skip
    return rows


@contextlib.contextmanager
def _station(priority: int, image_mb_per_s: float) -> Iterator[tuple[BusAddress, Path]]:
    """Run a bus, a G1 server, a commander and the load."""
    with contextlib.ExitStack() as stack:
        address, _ = stack.enter_context(processes.bus())
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="bench-")))
        environment, log = {"STATION_BUS": address.url}, folder / "g1.log"
        settings = (*upstream.G1_SETTINGS, f"real_time_priority={priority}")
        arguments = ("serve", "g1", *(word for setting in settings for word in ("--set", setting)))
        process = stack.enter_context(processes.station(*arguments, environment=environment, log=log))
        wait_active(address, "g1", process.pid, log)
        stack.enter_context(processes.Beside(commands.write_native, address, _COMMAND_HZ, bool(priority)))
        stack.enter_context(processes.Beside(traffic.write_small, address, _SMALL_PER_S))
        if image_mb_per_s:
            stack.enter_context(processes.Beside(traffic.write_images, address, image_mb_per_s))
        yield address, folder


def _with_recorder(address: BusAddress, folder: Path, seconds: float) -> Seen:
    with contextlib.ExitStack() as stack:
        data = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=folder)))
        stack.enter_context(recorder(address, data))
        line = stack.enter_context(Bus(address, name="bench", timeout_s=1.0))
        remote.ask(line, "start", task="bench")
        seen = _watch(address, seconds)
        remote.ask(line, "stop", timeout_s=60.0)
        return seen


def _watch(address: BusAddress, seconds: float) -> Seen:
    """Look on while the loop runs for so long; a look costs it a notification of 50 writes a second."""
    key = keys.policy_timing(twist_keys.TWIST2_ROBOT)
    steps: list[np.ndarray] = []
    with Bus(address, name="bench") as line, line.watch([key]) as watch:
        time.sleep(_SETTLE_S)
        newest, end_s = watch.latest(key), time.monotonic() + seconds
        while time.monotonic() < end_s:
            sample = watch.wait(key, after=newest, timeout_s=1.0)
            if sample is not None:
                steps.append(codec.parse_json_vector(sample.value))
                newest = sample
    return _seen(np.array(steps))


def _seen(steps: np.ndarray) -> Seen:
    """Make figures of the rows of `policy_timing`: tick, sequence number, then the stages [ns]."""
    read_ns, sent_ns = (steps[:, 2 + TIMING_STAGES.index(stage)] for stage in ("state_read", "sent"))
    is_next = np.diff(steps[:, 0]) == 1  # a step that we missed is none that the loop missed
    wake_ms = np.abs(np.diff(read_ns) * 1e-6 - 20.0)[is_next]
    return Seen(wake_ms.tolist(), ((sent_ns - read_ns) * 1e-6).tolist())


BENCHMARK = Benchmark(
    name="effect", title="Effect of the recorder on the policy loop", method=METHOD, run=run, needs_assets=True
)
