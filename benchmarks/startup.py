"""Benchmark: how long a start takes."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from adapters.robots.g1 import twist_keys
from benchmarks import processes, upstream
from benchmarks.harness import Benchmark, Row, Settings, Target, alternate, compare
from station import assets
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.errors import BusError

_STATE = twist_keys.state_body(twist_keys.TWIST2_ROBOT)

METHOD = """\
From the start of the process to the first state on the bus (`station serve g1` on a running bus), to the motion
server being active, the whole recording under way (`station up g1-sim-motion --record`, which starts bus, G1, recorder
and motion), both with what stock loads, and to the robot blending into the motion (`station demo`, with what is built
in). *Warm*: the compiled model is in the user's cache, as after the first run. Baselines: a process that does what a
stock simulation does before its first state (imports, meshes from XML, network, one step; without torch, viewer and
window), and ours with an empty cache."""


def run(settings: Settings) -> list[Row]:
    """Measure."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="bench-")))
        (folder / "warm").mkdir()
        _serve(folder, folder / "warm")  # fills the cache, and the system's cache of files

        def cold() -> Path:
            return Path(stack.enter_context(tempfile.TemporaryDirectory(dir=folder)))

        taken = alternate(
            {
                "serve": lambda: [_serve(folder, folder / "warm")],
                "up": lambda: [_up(folder, folder / "warm")],
                "stock": lambda: [_stock(folder)],
                "serve cold": lambda: [_serve(folder, cold())],
                "up cold": lambda: [_up(folder, cold())],
                "demo": lambda: [_demo(folder, folder / "warm")],
                "demo cold": lambda: [_demo(folder, cold())],
            },
            min(settings.rounds, 3),
        )
    stock_name = "stock simulation, to its first state"
    return [
        compare("`serve g1` to the first state, warm", "s", taken["serve"], taken["stock"], baseline=stock_name,
                target=Target(limit=2.5)),
        compare("`serve g1` to the first state, warm", "s", taken["serve"], taken["serve cold"],
                baseline="empty cache"),
        compare("`serve g1` to the first state, empty cache", "s", taken["serve cold"], taken["stock"],
                baseline=stock_name, target=Target(limit=8.0)),
        compare("`up` to the motion active, warm", "s", taken["up"], taken["stock"], baseline=stock_name,
                target=Target(limit=2.5)),
        compare("`up` to the motion active, warm", "s", taken["up"], taken["up cold"], baseline="empty cache"),
        compare("`demo` to the robot following, warm", "s", taken["demo"], taken["demo cold"], baseline="empty cache",
                target=Target(limit=2.5)),
    ]  # fmt: skip


def _serve(folder: Path, cache: Path) -> float:
    with processes.bus() as (address, _):
        environment = {"STATION_BUS": address.url, "XDG_CACHE_HOME": str(cache)}
        began_s = time.monotonic()
        with processes.station("serve", "g1", *upstream.settings(""), environment=environment, log=folder / "g1.log"):
            return processes.until(lambda: processes.has_key(address, _STATE)) - began_s


def _up(folder: Path, cache: Path) -> float:
    arguments = ("up", "g1-sim-motion", "--yes", "--record", "--task", "bench", *upstream.settings("g1."))
    return _station(folder, cache, arguments, lambda address: _is_active(address, "motion"))


def _demo(folder: Path, cache: Path) -> float:
    return _station(
        folder, cache, ("demo",), lambda address: processes.gate_state(address, twist_keys.TWIST2_ROBOT) == "entering"
    )


def _station(folder: Path, cache: Path, arguments: Sequence[str], holds: Callable[[BusAddress], bool]) -> float:
    environment = processes.own_station(folder) | {"XDG_CACHE_HOME": str(cache)}
    address = BusAddress(socket=str(folder / "run" / "station" / "bus.sock"))
    began_s = time.monotonic()
    data = ("--data", str(folder / "data"))
    with processes.station(*arguments, *data, environment=environment, log=folder / "station.log"):
        return processes.until(lambda: holds(address)) - began_s


def _stock(folder: Path) -> float:
    model, checkpoint = assets.resolve(upstream.ROBOT_MODEL), assets.resolve(upstream.CHECKPOINT)
    with processes.bus() as (address, port), (folder / "stock.log").open("ab") as log:
        command: Sequence[str] = ("-m", "benchmarks.stock_start", str(port), str(model), str(checkpoint))
        began_s = time.monotonic()
        process = subprocess.Popen([sys.executable, *command], stdout=log, stderr=log)
        try:
            return processes.until(lambda: processes.has_key(address, _STATE)) - began_s
        finally:
            process.kill()
            process.wait()


def _is_active(address: BusAddress, name: str) -> bool:
    with contextlib.suppress(BusError), Bus(address, name="bench") as line:  # the bus is started by what we wait for
        data = line.get(keys.server(name))
        return data is not None and msgspec.json.decode(data).get("state") == "active"
    return False


BENCHMARK = Benchmark(name="startup", title="Start", method=METHOD, run=run, needs_assets=True)
