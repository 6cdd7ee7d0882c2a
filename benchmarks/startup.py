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

from benchmarks import processes
from benchmarks.harness import Benchmark, Row, Settings, Target, alternate, compare
from station import assets
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.errors import BusError
from station.life.rig import DEFAULT_CHECKPOINTS, DEFAULT_ROBOT_MODEL

_LIMIT_S = 120.0
_STATE = keys.state_body(keys.TWIST2_ROBOT)

METHOD = """\
From the start of the process to the first state on the bus (`station serve g1` on a running bus), and to the motion
server being active, the whole recording under way (`station up g1-sim-motion --record`, which starts bus, G1, recorder
and motion). *Warm*: the compiled model is in the user's cache, as after the first run. Baselines: a process that does
what a stock simulation does before its first state (imports, meshes from XML, network, one step; without torch,
viewer and window), and ours with an empty cache."""


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
    ]  # fmt: skip


def _serve(folder: Path, cache: Path) -> float:
    with processes.bus() as (address, _):
        environment = {"STATION_BUS": address.url, "XDG_CACHE_HOME": str(cache)}
        began_s = time.monotonic()
        with processes.station("serve", "g1", environment=environment, log=folder / "g1.log"):
            return _until(lambda: _has(address, _STATE)) - began_s


def _up(folder: Path, cache: Path) -> float:
    environment = processes.own_station(folder) | {"XDG_CACHE_HOME": str(cache)}
    address = BusAddress(socket=str(folder / "run" / "station" / "bus.sock"))
    arguments = ("up", "g1-sim-motion", "--yes", "--record", "--task", "bench", "--data", str(folder / "data"))
    began_s = time.monotonic()
    with processes.station(*arguments, environment=environment, log=folder / "up.log"):
        return _until(lambda: _is_active(address, "motion")) - began_s


def _stock(folder: Path) -> float:
    model, checkpoint = assets.resolve(DEFAULT_ROBOT_MODEL), assets.resolve(DEFAULT_CHECKPOINTS["twist2"])
    with processes.bus() as (address, port), (folder / "stock.log").open("ab") as log:
        command: Sequence[str] = ("-m", "benchmarks.stock_start", str(port), str(model), str(checkpoint))
        began_s = time.monotonic()
        process = subprocess.Popen([sys.executable, *command], stdout=log, stderr=log)
        try:
            return _until(lambda: _has(address, _STATE)) - began_s
        finally:
            process.kill()
            process.wait()


def _until(holds: Callable[[], bool]) -> float:
    """Look every 5 ms; return the instant at which it held [s]."""
    deadline = time.monotonic() + _LIMIT_S
    while not holds():
        if time.monotonic() > deadline:
            raise RuntimeError(f"not started within {_LIMIT_S:.0f} s")
        time.sleep(0.005)
    return time.monotonic()


def _has(address: BusAddress, key: str) -> bool:
    with Bus(address, name="bench") as line:
        return line.get(key) is not None


def _is_active(address: BusAddress, name: str) -> bool:
    with contextlib.suppress(BusError), Bus(address, name="bench") as line:  # the bus is started by what we wait for
        data = line.get(keys.server(name))
        return data is not None and msgspec.json.decode(data).get("state") == "active"
    return False


BENCHMARK = Benchmark(name="startup", title="Start", method=METHOD, run=run, needs_assets=True)
