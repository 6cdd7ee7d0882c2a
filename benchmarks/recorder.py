"""Benchmark: what the recorder keeps up with."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import msgspec

from benchmarks import endurance, processes, stock, traffic
from benchmarks.harness import Benchmark, Rounds, Row, Settings, Target, alternate, compare, mean, p50, p99
from benchmarks.recorded import recorder
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.reading.reader import open_episode
from station.episode.recorder import remote

METHOD = """\
Writers publish 10,000 small values (180 B of JSON, ten keys) and 455 incompressible pictures of 66 kB (30 MB) a second
at once, through the real bus into the real recorder process. *Lost*: sequence numbers that the writers spent and that
the finished files do not hold. *Lag*: from the writer's clock before the write to the recorder's at its arrival, over
every message in the files; it stands under each message's log time. *CPU*: the recorder process while the load runs,
writing to disk included. Baseline: the same load, looked at by the stock recorder's pattern, a pipeline of GETs 30
times a second. *Growth*, with `--minutes N`: the slope of the recorder's resident memory over the last three quarters
of one episode of that length under the same load; what the disk holds of it is given back on the way."""


class Take(msgspec.Struct):
    """What came of one round."""

    written: int
    kept: int
    cpu_percent: float
    lag_ms: list[float]
    grown_mb: float
    written_per_s: float


def run(settings: Settings) -> list[Row]:
    """Measure."""
    seconds = settings.pick(10.0, 1.5)
    rounds = min(settings.rounds, 3)
    taken = alternate({"o": lambda: _ours(seconds), "t": lambda: _theirs(seconds)}, rounds)

    def of(name: str, field: str) -> Rounds:
        values = [getattr(take, field) for take in taken[name]]
        return [value if isinstance(value, list) else [value] for value in values]

    lost = [[float(take.written - take.kept)] for take in taken["o"]]
    lost_by_stock = [[float(take.written - take.kept)] for take in taken["t"]]
    seen = [[100.0 * take.kept / take.written] for take in taken["o"]]
    seen_by_stock = [[100.0 * take.kept / take.written] for take in taken["t"]]
    poll = "stock poll at 30 Hz"
    return [
        compare("load that the writers reached", "msg/s", of("o", "written_per_s"), of("t", "written_per_s"),
                baseline=poll),
        compare("lost", "msg", lost, lost_by_stock, baseline=poll, by=max, target=Target(limit=0)),
        compare("kept", "%", seen, seen_by_stock, baseline=poll, target=Target(limit=100, sense=">=")),
        compare("CPU of the recorder", "%", of("o", "cpu_percent"), of("t", "cpu_percent"), baseline=poll, by=mean,
                target=Target(limit=35)),
        compare("lag p50", "ms", of("o", "lag_ms"), by=p50),
        compare("lag p99", "ms", of("o", "lag_ms"), by=p99, target=Target(limit=50)),
        compare("memory gained over the second half", "MB", of("o", "grown_mb"), target=Target(limit=20)),
        *(endurance.rows(settings.minutes) if settings.minutes else []),
    ]  # fmt: skip


def _ours(seconds: float) -> Take:
    with processes.bus() as (address, _), tempfile.TemporaryDirectory(prefix="bench-") as name:
        data = Path(name)
        with recorder(address, data) as pid, Bus(address, name="bench", timeout_s=1.0) as line:
            remote.ask(line, "start", task="bench")
            (counts, took_s), used = _load(address, seconds, pid)
            answer = remote.ask(line, "stop", timeout_s=60.0)
        kept, lag_ms = _read(Path(str(answer.path)))
    written = sum(counts.values())
    return Take(written=written, kept=kept, lag_ms=lag_ms, written_per_s=written / took_s, **used)


def _theirs(seconds: float) -> Take:
    names = (*traffic.SMALL_KEYS, *traffic.IMAGE_KEYS)
    with processes.bus() as (address, port):
        poller = processes.Beside(stock.record, port, names)
        (counts, took_s), used = _load(address, seconds, poller.pid or 0)
        kept = poller.stop()
    written = sum(counts.values())
    return Take(written=written, kept=kept, lag_ms=[], written_per_s=written / took_s, **used)


def _load(address: BusAddress, seconds: float, pid: int) -> tuple[tuple[dict[str, int], float], dict[str, Any]]:
    """Write for so long; return what was written and how long it took, and what a process used meanwhile."""
    small = processes.Beside(traffic.write_small, address, traffic.SMALL_PER_S)
    images = processes.Beside(traffic.write_images, address, traffic.IMAGE_MB_PER_S)
    began_s, began_cpu_s = time.monotonic(), processes.cpu_s(pid)
    time.sleep(seconds / 2)
    half_mb = processes.resident_mb(pid)
    time.sleep(seconds / 2)
    took_s = time.monotonic() - began_s
    used = {
        "cpu_percent": 100.0 * (processes.cpu_s(pid) - began_cpu_s) / took_s,
        "grown_mb": processes.resident_mb(pid) - half_mb,
    }
    counts = small.stop() | images.stop()
    return (counts, took_s), used


def _read(episode: Path) -> tuple[int, list[float]]:
    """Return how many distinct writes of the load a finished episode holds, and the lag of each [ms]."""
    wanted = {*traffic.SMALL_KEYS, *traffic.IMAGE_KEYS}
    kept: dict[str, set[int]] = {name: set() for name in wanted}
    lag_ms = []
    for message in open_episode(episode).messages(wanted):
        kept[message.topic].add(message.sequence)
        lag_ms.append((message.log_ns - message.publish_ns) * 1e-6)
    return sum(len(numbers) for numbers in kept.values()), lag_ms


BENCHMARK = Benchmark(name="recorder", title="Recorder under load", method=METHOD, run=run)
