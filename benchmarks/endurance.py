"""Whether the recorder's memory grows: one long episode under the full load."""

from __future__ import annotations

import subprocess
import tempfile
import time
from pathlib import Path

import msgspec
import numpy as np

from benchmarks import processes, traffic
from benchmarks.harness import Row, Target
from benchmarks.recorded import recorder
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.recorder import remote
from station.episode.storage import layout
from station.episode.storage.request import RecorderState

_SAMPLE_S = 2.0
_KEPT_BYTES = 1 << 30  # of the episode on the disk; what is older is given back
_BLOCK = 1 << 20
_MOST_MB_PER_HOUR = 20.0


class Course(msgspec.Struct):
    """What was seen of a recorder: seconds since its start, resident memory [MB], and its last word."""

    seconds: list[float]
    resident_mb: list[float]
    state: RecorderState


def rows(minutes: float) -> list[Row]:
    """Measure for so long [min]."""
    course = _endure(minutes * 60.0)
    state = course.state
    return [
        Row(what=f"messages in {minutes:g} min", unit="msg", ours=float(state.messages)),
        Row(what=f"dropped in {minutes:g} min", unit="msg", ours=float(state.dropped), target=Target(limit=0)),
        Row(what="resident memory at the end", unit="MB", ours=course.resident_mb[-1]),
        Row(what="growth of the resident memory", unit="MB/h", ours=_mb_per_hour(course),
            target=Target(limit=_MOST_MB_PER_HOUR)),
    ]  # fmt: skip


def _endure(seconds: float) -> Course:
    with processes.bus() as (address, _), tempfile.TemporaryDirectory(prefix="bench-") as name:
        data = Path(name)
        with recorder(address, data) as pid, Bus(address, name="bench", timeout_s=1.0) as line:
            episode = Path(str(remote.ask(line, "start", task="bench").path))
            small = processes.Beside(traffic.write_small, address, traffic.SMALL_PER_S)
            images = processes.Beside(traffic.write_images, address, traffic.IMAGE_MB_PER_S)
            with small, images:
                course = _watch(address, pid, episode / layout.CAMERAS_ACTIVE, seconds)
            remote.ask(line, "stop", timeout_s=60.0)
    return course


def _watch(address: BusAddress, pid: int, file: Path, seconds: float) -> Course:
    """Note the memory of a recorder, and keep its episode from filling the disk."""
    began_s, given_back = time.monotonic(), 0
    at_s, resident_mb = [], []
    with Bus(address, name="bench-watch", timeout_s=1.0) as line:
        while (now_s := time.monotonic() - began_s) < seconds:
            at_s.append(now_s)
            resident_mb.append(processes.resident_mb(pid))
            given_back = _give_back(file, given_back)
            time.sleep(_SAMPLE_S)
        state = msgspec.json.decode(line.get(keys.RECORDER) or b"", type=RecorderState)
    return Course(at_s, resident_mb, state)


def _give_back(file: Path, begin: int) -> int:
    """Make a hole of all but the newest bytes of a file, from `begin`; return where it ends."""
    if not file.exists():  # no picture has come yet
        return begin
    end = (file.stat().st_size - _KEPT_BYTES) // _BLOCK * _BLOCK
    if end - begin < _KEPT_BYTES // 8:
        return begin
    span = ["--offset", str(begin), "--length", str(end - begin)]
    subprocess.run(["fallocate", "--punch-hole", *span, file], check=True)
    return end


def _mb_per_hour(course: Course) -> float:
    """Return the slope over all but the first quarter, in which queues and caches fill."""
    first = len(course.seconds) // 4
    return float(np.polyfit(course.seconds[first:], course.resident_mb[first:], 1)[0]) * 3600.0
