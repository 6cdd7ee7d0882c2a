"""Benchmark: from episodes to a LeRobot data set, few long ones and thousands of short ones."""

from __future__ import annotations

import io
import os
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from adapters.robots.g1 import twist_keys
from benchmarks.harness import Benchmark, Row, Settings, Target, alternate, compare, p50
from station import registry
from station.bus import codec, contracts, keys
from station.bus.robot_streams import QUAT
from station.bus.stamp import Stamp, boot_id
from station.bus.tap import Write
from station.episode.quality.check import check, write_measured
from station.episode.reading.reader import open_episode
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage import layout
from station.episode.storage.anchor import Anchor
from station.episode.storage.manifest import Manifest, Robot, Task, Timing, dump_manifest, load_manifest
from station.episode.storage.progress import Totals
from station.episode.writing.closing import close_manifest
from station.export.kind import ExportKind, Source
from station.export.run import Exported, Workers, export
from station.export.select import sources
from station.export.shards import Outcome
from station.protocols import Floats

ROBOT = twist_keys.TWIST2_ROBOT
CAMERA = keys.camera_image("head")
_STATE_HZ, _FRAME_HZ = 50, 30
_WALL_NS, _MONO_NS = 1_795_000_000_000_000_000, 1_000_000_000_000
_WIDTH, _HEIGHT = 640, 480
_MB = 1e-6

METHOD = """\
Episodes as the recorder writes them, with a G1's state and command at 50 Hz, are exported by the code behind
`station export lerobot` (v3.0), statistics and waiting for the disk included. *Many*: thousands of 2 s without
pictures, in one process; all have the numbers of one recording, each has a manifest of its own. The cost of an episode
is the time from one to the next, as the median of a hundred; memory is what the process has resident. *Joining* makes
one data set of their shards. *Speed*: 200 episodes of 20 s without pictures, and 4 with a camera of 640x480 at 30 Hz
whose JPEG files become H.264; minutes of robot time in a second, of one process per core against one process alone."""


def run(settings: Settings) -> list[Row]:
    """Measure."""
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        folder = Path(name)
        rows = _many(folder, round(settings.pick(2000, 40)), round(settings.pick(100, 10)))
        seconds = settings.pick(20.0, 2.0)
        for what, count, has_camera in (("without pictures", 200, False), ("with a camera", 4, True)):
            place = folder / f"{has_camera}"
            data = several(place / "data", round(settings.pick(count, 2)), seconds, has_camera=has_camera)
            rows.append(_speed(what, place, sources((), data), settings))
            shutil.rmtree(place)
    return rows


def _many(folder: Path, count: int, window: int) -> list[Row]:
    ends: list[tuple[float, float]] = []
    found = sources((), several(folder / "data", count, 2.0))
    ends.append((time.monotonic(), _resident()))
    done = _export(found, folder / "out", 1, lambda _: ends.append((time.monotonic(), _resident())))
    joined_s = time.monotonic() - ends[-1][0]
    assert done.episodes == count, done.failed
    costs = [(after[0] - before[0]) * 1e3 for before, after in pairwise(ends)][1:]  # the first loads the libraries
    memory = [resident for _, resident in ends[1:]]
    return [
        _against(f"many: an episode, the last {window} of {count}", "ms", f"the first {window}",
                 p50(costs[-window:]), p50(costs[:window])),
        _against("many: memory after the last", "MB", f"after {window}", memory[-1] * _MB, memory[window - 1] * _MB),
        Row(what=f"many: joining {count} episodes, each", unit="ms", ours=joined_s / count * 1e3),
        Row(what="many: robot time converted, one process", unit="min/s", ours=done.seconds / 60.0 / done.took_s),
    ]  # fmt: skip


def _against(what: str, unit: str, baseline: str, ours: float, theirs: float) -> Row:
    target = Target(limit=1.1, of="ratio")
    return Row(what=what, unit=unit, ours=ours, baseline=baseline, theirs=theirs, ratio=ours / theirs, target=target)


def _speed(what: str, folder: Path, found: Sequence[Source], settings: Settings) -> Row:
    def minutes_per_s(jobs: int) -> list[float]:
        out = folder / "out"
        done = _export(found, out, jobs)
        shutil.rmtree(out)
        return [done.seconds / 60.0 / done.took_s]

    turns = {"all": lambda: minutes_per_s(0), "one": lambda: minutes_per_s(1)}
    taken = alternate(turns, round(settings.pick(3, 1)))
    return compare(f"speed {what}", "min/s", taken["all"], taken["one"], baseline="one process")


def _export(found: Sequence[Source], out: Path, jobs: int, on_done: Any = None) -> Exported:
    kind: ExportKind = registry.find("export", "lerobot")

    def on_result(outcome: Outcome) -> None:
        if on_done is not None:
            on_done(outcome)

    options = kind.options(min_quality="any")  # copies of one episode under other names are no good ones
    return export(kind, found, options, out, where=Workers(jobs=jobs), on_done=on_result)


def _resident() -> float:
    """Return what of this process is in memory [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def several(data: Path, count: int, seconds: float, *, has_camera: bool = False) -> Path:
    """Make a data folder of so many checked episodes; return it."""
    first = _record(data / "bench" / "bench-00000", seconds, has_camera=has_camera)
    write_measured(first, check(open_episode(first)))
    manifest = load_manifest(first)
    for number in range(1, count):
        folder = first.with_name(f"bench-{number:05d}")
        folder.mkdir()
        for file in first.glob("*.mcap"):
            os.link(file, folder / file.name)
        manifest.episode_id = folder.name
        (folder / layout.MANIFEST).write_bytes(dump_manifest(manifest))
    return data


def _record(folder: Path, seconds: float, *, has_camera: bool) -> Path:
    folder.mkdir(parents=True)
    anchor = Anchor(wall_ns=_WALL_NS, mono_ns=_MONO_NS, boot=boot_id())
    manifest = Manifest(
        episode_id=folder.name, task=Task(name="bench", instruction="walk"), robot=Robot(suffix=ROBOT),
        timing=Timing(anchor=anchor, duration_s=seconds),
    )  # fmt: skip
    manifest.recorder.backend, manifest.recorder.is_lossless = "replication", True
    writer = EpisodeWriter(folder, anchor=anchor, manifest=manifest)

    def closing(totals: Totals) -> Manifest:
        close_manifest(manifest, anchor, totals)
        return manifest

    for write in _writes(seconds, has_camera=has_camera):
        while writer.load > 0.25:
            time.sleep(0.001)
        assert not writer.put([write], is_live=False)
    writer.finish(closing)
    assert writer.wait(60.0), "the disk does not take the episode"
    assert not writer.error, writer.error
    return folder


def _writes(seconds: float, *, has_camera: bool) -> Iterator[Write]:
    """Yield what a station would write, in order of time."""
    source, counts = f"g1.1.{boot_id()}.beef", {key: 0 for key in (*_keys(), CAMERA)}

    def write(key: str, value: bytes, at_s: float, capture_s: float | None = None) -> Write:
        counts[key] += 1
        mono_ns = _MONO_NS + round(at_s * 1e9)
        capture_ns = None if capture_s is None else _MONO_NS + round(capture_s * 1e9)
        mark = Stamp(counts[key], mono_ns, _WALL_NS + round(at_s * 1e9), source, capture_ns)
        return Write(key, value, mark.encode(), mono_ns + 200_000)

    frames = 0
    for tick in range(round(seconds * _STATE_HZ)):
        at_s = tick / _STATE_HZ
        while has_camera and frames / _FRAME_HZ <= at_s:
            taken_s = frames / _FRAME_HZ
            frames += 1
            yield write(CAMERA, _picture(frames), max(taken_s, at_s), taken_s)
        for key, names in _keys().items():
            values = codec.f64(_motion(names, at_s))
            yield write(key, values, at_s + (0.004 if key == keys.command_used(ROBOT) else 0.0))


def _keys() -> dict[str, tuple[str, ...]]:
    """Return the keys of an episode, and what their numbers are called."""
    wanted = (contracts.contract(key) for key in (keys.robot_state(ROBOT), keys.command_used(ROBOT)))
    return {contract.key: contract.names for contract in wanted if contract is not None}


def _motion(names: Sequence[str], at_s: float) -> Floats:
    """Return joints that swing, each at a phase of its own, and an upright root: a check finds nothing odd in it."""
    joints = [name.rpartition("_")[0] for name in names if name.endswith("_pos")]
    turn = 2.5 * at_s + np.arange(len(joints))
    known = dict(zip((f"{joint}_pos" for joint in joints), 0.3 * np.sin(turn), strict=True))
    known |= dict(zip((f"{joint}_vel" for joint in joints), 0.75 * np.cos(turn), strict=True)) | {QUAT[0]: 1.0}
    return np.array([known.get(name, 0.0) for name in names])


def _picture(number: int) -> bytes:
    """Return a picture with texture that moves, as a JPEG file of about 60 kB."""
    from PIL import Image

    y, x = np.mgrid[0:_HEIGHT, 0:_WIDTH]
    grain = np.random.default_rng(0).integers(0, 24, (_HEIGHT, _WIDTH))
    planes = [(96 + 60 * np.sin((x + scale * number) / 37.0) * np.cos(y / 29.0) + grain) for scale in (1, 2, 3)]
    file = io.BytesIO()
    Image.fromarray(np.stack(planes, axis=-1).astype(np.uint8)).save(file, "JPEG", quality=90)
    return file.getvalue()


BENCHMARK = Benchmark(name="export", title="Export", method=METHOD, run=run)
