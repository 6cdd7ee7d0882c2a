"""Benchmark: what raw depth costs the commands, on their bus and on a bulk bus of its own."""

from __future__ import annotations

import contextlib
import mmap
import os
import random
import struct
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks import commands, processes, stock
from benchmarks.harness import Benchmark, Row, Settings, Target, alternate, compare, p50, p99
from station.bus import keys
from station.bus.address import BusAddress, bulk_of
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.server_options import bulk_options
from station.episode.recorder.both_taps import open_taps
from station.life.loop import Rate, real_time

_COMMANDS_HZ = 250.0
_DEPTH_BYTES = 640 * 480 * 2
_CAMERAS, _DEPTH_HZ = 2, 25.0  # 31 MB/s
_NICENESS = 5  # as of a camera's server
_SETTLE_S = 1.0
_LIVE_HZ = 30.0
_SLOTS = 8
_HEAD = struct.Struct("<QQ")  # sequence number and size of the newest picture
PICTURES = {"depth 640x480": 640 * 480 * 2, "colour 1280x720": 1280 * 720 * 3}
RING = "ring in shared memory"
_KEY = keys.camera_depth("bench")
APART, TOGETHER, NONE = "on a bulk bus", "raw depth on the one bus", "no depth at all"

METHOD = """\
A process writes the command at 250 Hz, another hears it by a `Watch`; meanwhile a third, nice 5, writes two raw depth
pictures of 640x480 at 25 Hz (31 MB/s), and a fourth taps all of it as a recorder does. *Arrival*: from the writer's
clock before the write to the value being in the reader. Writer, reader and the bus of the commands are under SCHED_FIFO
where that is permitted, as the station's servers ask for; a bulk bus never is.
*Newest picture*: what a live reader on the same machine pays 30 times a second for the newest picture, over the socket
of the bulk bus, and as a copy out of a ring of 8 in shared memory with its sequence number checked before and after:
the least that any ring costs. Another process writes both at 30 Hz."""


def run(settings: Settings) -> list[Row]:
    """Measure."""
    seconds, is_fifo = settings.pick(8.0, 1.0), processes.fifo_is_permitted()
    with contextlib.ExitStack() as stack:
        turns = {
            name: _turn(stack, seconds, is_fifo=is_fifo, has_bulk=name == APART, has_depth=name != NONE)
            for name in (APART, TOGETHER, NONE)
        }
        taken = alternate(turns, settings.rounds)
    apart = taken[APART]
    return [
        compare("command's arrival p50", "ms", apart, taken[TOGETHER], baseline=TOGETHER, by=p50),
        compare("command's arrival p99", "ms", apart, taken[TOGETHER], baseline=TOGETHER, by=p99,
                target=Target(limit=1.0, of="ratio")),
        compare("command's arrival p50", "ms", apart, taken[NONE], baseline=NONE, by=p50),
        compare("command's arrival p99", "ms", apart, taken[NONE], baseline=NONE, by=p99),
        *(row for name, size in PICTURES.items() for row in _newest(settings, name, size)),
    ]  # fmt: skip


def _newest(settings: Settings, name: str, size: int) -> list[Row]:
    """Measure how long the newest picture of a size takes to be read [ms]."""
    count = int(settings.pick(150, 15))
    with processes.bus(is_fifo=False) as (address, _), tempfile.TemporaryDirectory(dir="/dev/shm") as folder:
        ring = Path(folder) / "ring"
        ring.write_bytes(bytes(_SLOTS * (_HEAD.size + size)))
        with (
            processes.Beside(write_both, address, ring, size),
            processes.Worker(read_newest, address, ring, size) as one,
        ):
            taken = alternate(
                {"bus": lambda: one.ask("bus", count), RING: lambda: one.ask(RING, count)}, settings.rounds
            )
    return [
        compare(f"newest picture, {name}, {by.__name__}", "ms", taken["bus"], taken[RING], baseline=RING, by=by)
        for by in (p50, p99)
    ]


def _turn(
    stack: contextlib.ExitStack, seconds: float, *, is_fifo: bool, has_bulk: bool, has_depth: bool
) -> Callable[[], list[float]]:
    """Return what measures for so many seconds, with its load beside it for as long."""
    address, _ = stack.enter_context(processes.bus(is_fifo=is_fifo))
    if has_bulk:
        folder = Path(address.socket or "").parent
        options = ServerOptions(folder=folder, socket=folder / "bus.sock")
        stack.enter_context(RedisServer.start(bulk_options(options)))
    hearer = stack.enter_context(processes.Worker(hear, address, is_fifo))

    def measure() -> list[float]:
        with contextlib.ExitStack() as load:
            load.enter_context(processes.Beside(commands.write_native, address, _COMMANDS_HZ, is_fifo))
            load.enter_context(processes.Beside(tap, address))
            if has_depth:
                load.enter_context(processes.Beside(write_depth, address))
            time.sleep(_SETTLE_S)
            taken: list[float] = hearer.ask(seconds)
        return taken

    return measure


@contextlib.contextmanager
def hear(address: BusAddress, is_fifo: bool) -> Iterator[Callable[[float], list[float]]]:
    """Hear commands in this process; yields what does it for so many seconds, and returns how long each took [ms]."""
    key = stock.COMMAND_KEYS[0]
    with Bus(address, name="bench-hearer") as line, line.watch([key]) as watch:
        if is_fifo:
            real_time()

        def act(seconds: float) -> list[float]:
            taken, newest, end_s = [], watch.latest(key), time.monotonic() + seconds
            while time.monotonic() < end_s:
                newest = watch.wait(key, after=newest, timeout_s=0.1) or newest
                if newest is not None and newest.stamp is not None and newest.arrived_ns is not None:
                    taken.append((newest.arrived_ns - newest.stamp.mono_ns) * 1e-6)
            return taken

        yield act


def write_depth(stop: processes.Stop, address: BusAddress) -> None:
    """Publish raw depth of some cameras until told to stop."""
    os.nice(_NICENESS)
    picture, rate = random.Random(1).randbytes(_DEPTH_BYTES), Rate(_DEPTH_HZ)
    with Bus(address, name="bench-depth", timeout_s=1.0) as line:
        while not stop():
            rate.wait()
            for camera in range(_CAMERAS):
                line.publish({keys.camera_depth(f"bench_{camera}"): picture})


def tap(stop: processes.Stop, address: BusAddress) -> None:
    """Read every write, as a recorder does, until told to stop."""
    with contextlib.closing(
        open_taps(address, bulk_of(address), resume=None, backend=None, since_ns=time.monotonic_ns())
    ) as line:
        while not stop():
            line.read(0.02)


def write_both(stop: processes.Stop, address: BusAddress, ring: Path, size: int) -> None:
    """Publish pictures of a size until told to stop, and put each into the ring."""
    pictures, rate, count = [random.Random(seed).randbytes(size) for seed in range(2)], Rate(_LIVE_HZ), 0
    with Bus(address, name="bench-camera", timeout_s=1.0) as line, ring.open("r+b") as file:
        memory = mmap.mmap(file.fileno(), 0)
        while not stop():
            picture = pictures[count % 2]
            line.publish({_KEY: picture})
            count += 1
            place = count % _SLOTS * (_HEAD.size + size)
            _HEAD.pack_into(memory, place, 0, 0)
            memory[place + _HEAD.size : place + _HEAD.size + size] = picture
            _HEAD.pack_into(memory, place, count, size)
            rate.wait()


@contextlib.contextmanager
def read_newest(address: BusAddress, ring: Path, size: int) -> Iterator[Callable[[str, int], list[float]]]:
    """Read the newest picture in this process; yields what does it so often, and returns how long each took [ms]."""
    places = range(0, _SLOTS * (_HEAD.size + size), _HEAD.size + size)
    rate = Rate(_LIVE_HZ)
    with Bus(address, name="bench-viewer", timeout_s=1.0) as line, ring.open("rb") as file:
        memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)

        def from_ring() -> bytes | None:
            number, place = max((_HEAD.unpack_from(memory, place)[0], place) for place in places)
            picture = memory[place + _HEAD.size : place + _HEAD.size + size]
            return picture if _HEAD.unpack_from(memory, place)[0] == number else None

        def act(what: str, count: int) -> list[float]:
            read, taken = (from_ring if what == RING else lambda: line.get(_KEY)), []
            for _ in range(count):
                rate.wait()
                began_ns = time.perf_counter_ns()
                picture = read()
                taken.append((time.perf_counter_ns() - began_ns) * 1e-6)
                assert picture is None or len(picture) == size
            return taken

        yield act


BENCHMARK = Benchmark(name="bulk", title="Raw depth beside commands", method=METHOD, run=run)
