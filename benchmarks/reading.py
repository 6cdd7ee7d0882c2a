"""Benchmark: how fast a recording is read and audited."""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from mcap.reader import make_reader

from benchmarks import processes, upstream
from benchmarks.harness import Benchmark, Row, Settings, Target, alternate, compare
from station import python_child
from station.episode.reading.reader import EpisodeReader
from station.episode.replaying.audit import audit
from station.episode.replaying.recorded_policy import load_policy, recorded_policies
from station.episode.storage.folder import signals_file

_RUN_S = 180.0

METHOD = """\
An episode that the real station has just recorded (`station up g1-sim-motion` with TWIST2's policy, model and motion,
about 1,000 messages a second) is read whole in the order of the file, and its policy steps are audited, network
included. Recorded time over the time taken. Baselines: the `mcap` library's own reader (`make_reader`, in log-time
order as it does by default, and in the order of the file), and real time."""


def run(settings: Settings) -> list[Row]:
    """Measure."""
    with _episode(settings.pick(25.0, 5.0)) as path:
        reader = EpisodeReader(path)
        recorded_s = _recorded_s(reader)
        policy = load_policy(reader, recorded_policies(reader)[""])
        taken = alternate(
            {
                "ours": lambda: [recorded_s / _read(path)],
                "mcap, log order": lambda: [recorded_s / _read_plain(path, in_log_order=True)],
                "mcap, file order": lambda: [recorded_s / _read_plain(path, in_log_order=False)],
                "audit": lambda: [audit(reader, policy=policy).speed_x_realtime],
                "real time": lambda: [1.0],
            },
            settings.rounds,
        )
    unit, at_least_30 = "x real time", Target(limit=30.0, sense=">=")
    return [
        compare("reading every message", unit, taken["ours"], taken["mcap, log order"],
                baseline="mcap, log order", target=at_least_30),
        compare("reading every message", unit, taken["ours"], taken["mcap, file order"], baseline="mcap, file order"),
        compare("audit", unit, taken["audit"], taken["real time"], baseline="real time",
                target=Target(limit=20.0, sense=">=")),
    ]  # fmt: skip


@contextlib.contextmanager
def _episode(seconds: float) -> Iterator[Path]:
    """Record an episode with a station of its own; yields its MCAP file."""
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        folder = Path(name)
        settings = (*(f"g1.{setting}" for setting in upstream.G1_SETTINGS), f"motion.motion={upstream.MOTION}")
        run = python_child.command("-m", "station", "up", "g1-sim-motion", "--yes", "--record", "--task", "bench")
        run += [word for setting in settings for word in ("--set", setting)]
        result = subprocess.run(
            [*run, "--for", f"{seconds:g}s", "--data", str(folder / "data")],
            env=processes.own_station(folder), capture_output=True, text=True, timeout=_RUN_S, check=False,
        )  # fmt: skip
        found = sorted((folder / "data" / "bench").glob("*/manifest.yaml"))
        if result.returncode != 0 or not found:
            raise RuntimeError(f"no episode was recorded: {result.stdout[-2000:]}{result.stderr[-2000:]}")
        yield signals_file(found[-1].parent)


def _recorded_s(reader: EpisodeReader) -> float:
    streams = [stream for stream in reader.streams() if stream.count]
    return (max(s.last_ns for s in streams) - min(s.first_ns for s in streams)) * 1e-9


def _read(path: Path) -> float:
    began_s = time.perf_counter()
    count = sum(1 for _ in EpisodeReader(path).messages())
    assert count
    return time.perf_counter() - began_s


def _read_plain(path: Path, *, in_log_order: bool) -> float:
    began_s = time.perf_counter()
    with path.open("rb") as file:
        count = sum(1 for _ in make_reader(file).iter_messages(log_time_order=in_log_order))
    assert count
    return time.perf_counter() - began_s


BENCHMARK = Benchmark(name="reading", title="Reading and auditing", method=METHOD, run=run, needs_assets=True)
