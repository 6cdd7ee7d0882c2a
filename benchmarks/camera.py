"""Benchmark: from a camera to whoever reads the bus."""

from __future__ import annotations

import contextlib
import os
import struct
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import redis

from adapters.cameras.encode import Encoder
from adapters.robots.g1 import twist_keys
from benchmarks import processes
from benchmarks.harness import Benchmark, Rounds, Row, Settings, Target, alternate, compare, mean, p50, p99
from benchmarks.recorded import wait_active
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.watch import Watch
from station.life.loop import Rate

_FPS, _WIDTH, _HEIGHT, _QUALITY, _PICTURES = 30.0, 640, 480, 90, 30
_MANY, _READY_S = 4, 30.0
_ROBOT = twist_keys.TWIST2_ROBOT
_TIME = struct.Struct("<q")  # behind the picture of the bare loop, which has no stamp
BARE = "bare loop"

METHOD = """\
JPEG files of 640x480 at quality 90 (a textured scene), 30 a second, from one camera and from four at once, each a
process of its own. *Ours*: the camera server with its source `files`; it reads a file, looks whether it is whole, and
writes it with its stamp. Baseline: a process per camera that reads the same file, sets the key by `redis-py` and
sleeps for what is left of the period. *Time to the reader*: from the instant at which the picture was due (ours), or
the file was begun to be read (baseline), to its arrival at another process's `Watch`, on one machine's monotonic
clock. Our process stands back behind others (nice 5), which costs time to the reader on a busy machine; a picture
should be there before the next is taken. *CPU* is per camera, of the whole process. *Simulated*: the head camera of
the built-in G1, drawn and encoded in the camera server from a state that is written 50 times a second; the time is
from that write, so waiting for the next picture (10 ms in the mean) is in it. Drawn without a graphics card, unless
there is one."""


class Seen(msgspec.Struct):
    """What was seen of a contender in a round."""

    latency_ms: list[float]
    pictures_hz: float
    cpu_percent: float


def run(settings: Settings) -> list[Row]:
    """Measure."""
    seconds, rounds = settings.pick(6.0, 1.5), min(settings.rounds, 3)
    with tempfile.TemporaryDirectory(prefix="bench-") as name, processes.bus() as (address, port):
        folder = Path(name)
        _write_pictures(folder)
        with processes.Worker(read_bus, address) as reader:
            turns: dict[str, Callable[[], Seen]] = {}
            for count in (1, _MANY):
                turns[f"ours {count}"] = lambda count=count: _ours(address, folder, reader, count, seconds)  # type: ignore[misc]
                turns[f"bare {count}"] = lambda count=count: _bare(port, folder, reader, count, seconds)  # type: ignore[misc]
            taken = alternate(turns, rounds)
            rows = [row for count in (1, _MANY) for row in _rows(taken, count)]
            drawn = [_simulated(address, folder, reader, seconds) for _ in range(rounds)]
    return [*rows, *_rows_of_simulated(drawn)]


def _write_pictures(folder: Path) -> None:
    """Leave files of a scene with texture, about 50 kB each."""
    random, encoder = np.random.default_rng(0), Encoder(_QUALITY)
    rows, columns = np.mgrid[0:_HEIGHT, 0:_WIDTH]
    for number in range(_PICTURES):
        waves = np.sin((columns + 4 * number) / 17.0) * np.cos(rows / 23.0) * 60.0 + 120.0
        noise = random.normal(0.0, 4.0, (_HEIGHT, _WIDTH))
        pixels = (waves + noise)[:, :, None] * np.array([1.0, 0.9, 0.8])
        (folder / f"{number}.jpg").write_bytes(encoder.rgb(pixels.clip(0, 255).astype(np.uint8)))


@contextlib.contextmanager
def read_bus(address: BusAddress) -> Iterator[Callable[[list[str], float], Seen]]:
    """Read the bus in this process; yields what watches cameras for so many seconds."""

    def act(cameras: list[str], seconds: float) -> Seen:
        with (
            Bus(address, name="bench-reader") as line,
            line.watch([keys.camera_image(name) for name in cameras]) as watch,
        ):
            return _watch(watch, [keys.camera_image(name) for name in cameras], seconds)

    yield act


def _watch(watch: Watch, wanted: list[str], seconds: float) -> Seen:
    seen, newest = Seen([], 0.0, 0.0), {key: watch.latest(key) for key in wanted}
    began_s = time.monotonic()
    while (elapsed_s := time.monotonic() - began_s) < seconds:
        watch.wait(wanted[0], after=newest[wanted[0]], timeout_s=0.01)
        for key in wanted:
            sample = watch.latest(key)
            if sample is None or sample is newest[key] or sample.arrived_ns is None:
                continue
            newest[key] = sample
            marked = sample.stamp.capture_ns if sample.stamp is not None else None
            taken_ns = marked if marked is not None else _TIME.unpack(sample.value[-_TIME.size :])[0]
            seen.latency_ms.append((sample.arrived_ns - taken_ns) * 1e-6)
    seen.pictures_hz = len(seen.latency_ms) / elapsed_s / len(wanted)
    return seen


def _ours(address: BusAddress, folder: Path, reader: processes.Worker, count: int, seconds: float) -> Seen:
    settings = ["source=files", f"options.path={folder}", f"fps={_FPS:g}"]
    names = [f"bench_{number}" for number in range(count)]
    with contextlib.ExitStack() as stack:
        pids = [stack.enter_context(_server(address, folder, name, settings)) for name in names]
        return _measure(reader, names, pids, seconds)


def _bare(port: int, folder: Path, reader: processes.Worker, count: int, seconds: float) -> Seen:
    names = [f"bare_{number}" for number in range(count)]
    with contextlib.ExitStack() as stack:
        loops = [stack.enter_context(processes.Beside(bare_loop, port, str(folder), name)) for name in names]
        _wait_for_pictures(port, names)
        return _measure(reader, names, [loop.pid or 0 for loop in loops], seconds)


def _wait_for_pictures(port: int, names: list[str]) -> None:
    line, wanted = redis.Redis(port=port), [keys.camera_image(name) for name in names]
    line.delete(*wanted)  # those of the round before
    deadline_s = time.monotonic() + _READY_S
    while not all(line.mget(wanted)):
        if time.monotonic() > deadline_s:
            raise RuntimeError(f"the bare loops wrote nothing within {_READY_S:.0f} s")
        time.sleep(0.02)


def _simulated(address: BusAddress, folder: Path, reader: processes.Worker, seconds: float) -> Seen | None:
    """Measure the head camera of a simulated robot; None on a machine that cannot draw."""
    with processes.Beside(write_states, address):
        try:
            with _server(address, folder, "bench_head", ["source=mujoco", f"fps={_FPS:g}"]) as pid:
                return _measure(reader, ["bench_head"], [pid], seconds)
        except RuntimeError:
            return None


def _measure(reader: processes.Worker, names: list[str], pids: list[int], seconds: float) -> Seen:
    began_s, before_s = time.monotonic(), sum(map(processes.cpu_s, pids))
    seen: Seen = reader.ask(names, seconds)
    used_s = sum(map(processes.cpu_s, pids)) - before_s
    seen.cpu_percent = 100.0 * used_s / (time.monotonic() - began_s) / len(pids)
    return seen


@contextlib.contextmanager
def _server(address: BusAddress, folder: Path, name: str, settings: list[str]) -> Iterator[int]:
    """Run a camera server; yields its process id when it publishes."""
    log = folder / f"{name}.log"
    options = [word for setting in settings for word in ("--set", setting)]
    environment = {"STATION_BUS": address.url, "XDG_RUNTIME_DIR": str(folder)}
    with processes.station("serve", "camera", "--name", name, *options, environment=environment, log=log) as process:
        wait_active(address, name, process.pid, log)
        yield process.pid


def bare_loop(stop: processes.Stop, port: int, folder: str, name: str) -> None:
    """Set the key of a camera to a file of a folder, 30 times a second, as a script would."""
    line, files = redis.Redis(port=port), sorted(Path(folder).glob("*.jpg"))
    number = 0
    while not stop():
        began_ns = time.monotonic_ns()
        data = files[number % len(files)].read_bytes()
        line.set(keys.camera_image(name), data + _TIME.pack(began_ns))
        number += 1
        time.sleep(max(0.0, 1.0 / _FPS - (time.monotonic_ns() - began_ns) * 1e-9))


def write_states(stop: processes.Stop, address: BusAddress) -> None:
    """Write the state of a robot that moves its arms, 50 times a second."""
    from adapters.robots.g1.mujoco_g1 import START_Q, START_ROOT_POS

    q, rate = np.array(START_Q, dtype=float), Rate(50.0)
    with Bus(address, name="bench-robot") as line:
        while not stop():
            rate.wait()
            q[18] = q[25] = 0.6 + 0.5 * np.sin(time.monotonic())
            line.publish({keys.sim_qpos(_ROBOT): codec.f64(np.concatenate([START_ROOT_POS, [1, 0, 0, 0], q]))})


def _rows(taken: dict[str, list[Seen]], count: int) -> list[Row]:
    def of(name: str, field: str) -> Rounds:
        values: list[Any] = [getattr(seen, field) for seen in taken[f"{name} {count}"]]
        return [value if isinstance(value, list) else [value] for value in values]

    def row(what: str, unit: str, field: str, **more: Any) -> Row:
        cameras = "1 camera" if count == 1 else f"{count} cameras"
        return compare(f"{cameras}: {what}", unit, of("ours", field), of("bare", field), baseline=BARE, **more)

    return [
        row("pictures, each", "1/s", "pictures_hz", by=mean, target=Target(limit=0.99 * _FPS, sense=">=")),
        row("time to the reader, p50", "ms", "latency_ms", by=p50),
        row("time to the reader, p99", "ms", "latency_ms", by=p99, target=Target(limit=33.0)),
        row("CPU, each", "%", "cpu_percent", by=mean, target=Target(limit=5.0)),
    ]


def _rows_of_simulated(drawn: list[Seen | None]) -> list[Row]:
    seen = [one for one in drawn if one is not None and one.latency_ms]
    if not seen:
        return []
    return [
        compare("simulated head camera: pictures", "1/s", [[one.pictures_hz] for one in seen], by=mean),
        compare("simulated head camera: time to the reader, p50", "ms", [one.latency_ms for one in seen], by=p50),
        compare(
            f"simulated head camera: CPU ({os.cpu_count()} cores)", "%", [[one.cpu_percent] for one in seen], by=mean
        ),
    ]


BENCHMARK = Benchmark(name="camera", title="From a camera to the bus", method=METHOD, run=run)
