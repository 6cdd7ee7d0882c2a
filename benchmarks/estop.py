"""Benchmark: from the write of the emergency stop to joints that are damped."""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from random import Random
from typing import NamedTuple

from adapters.robots.g1 import twist_keys
from benchmarks import network, processes, stock
from benchmarks.harness import Benchmark, Rounds, Row, Settings, Target, alternate, compare, p50, p99
from benchmarks.processes import Stop
from benchmarks.recorded import wait_active
from station import registry
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.tap import Tap, open_tap
from station.contract import TIMING_STAGES
from station.motion.playback import Playback

_STEP_MS, _LOOP_HZ = 20.0, 50.0
_PAUSE_S = (0.12, 0.16)  # between stops; its spread is two steps, so every phase of a step is met
_GIVE_UP_S = 5.0
OURS, STOCK = "ours", "polled once per step"
ROBOT = twist_keys.TWIST2_ROBOT

METHOD = """\
The G1 server (built-in model and policy, scheduled as it asks for) follows a walk that is played in a loop;
`station:estop` is written at random moments of a step, released, and written again once the robot follows commands
that have begun anew. From the writer's clock before the write to the instant the loop sends the first targets without
stiffness (`policy_timing`, `target`), taken from the replication link, so that no step is missed. Baselines: *one
policy step*, the 20 ms in which a stop is promised to act; and what a stock loop would take: stock has no emergency
stop on the bus (only the real robot's remote has one), so its pattern, a GET in each cycle with relative sleeps and
the network, is given one to read. *Loaded*: a process of normal priority on every core."""


class _Step(NamedTuple):
    """What a step of the loop sent, and when."""

    sent_ns: int
    is_stopped: bool
    is_damped: bool
    follows: bool


def run(settings: Settings) -> list[Row]:
    """Measure."""
    stops = round(settings.pick(50, 5))
    rows: list[Row] = []
    with contextlib.ExitStack() as stack:
        address = stack.enter_context(_station())
        stack.enter_context(processes.Beside(_walk, address))
        _, port = stack.enter_context(processes.bus(is_fifo=False))
        stack.enter_context(processes.Beside(_press_stock, port))
        worker = stack.enter_context(processes.Worker(_stock_reader, port))
        for condition, beside in (("quiet", processes.nothing), ("loaded", processes.burners)):
            with beside():
                contenders = {
                    OURS: lambda: _stops(address, stops),
                    STOCK: lambda: list[float](worker.ask(stops * sum(_PAUSE_S) / 2)),
                }
                rows += _rows(condition, alternate(contenders, settings.rounds))
    return rows


def _rows(condition: str, taken: Mapping[str, Rounds]) -> list[Row]:
    ours, theirs = taken[OURS], taken[STOCK]
    count = sum(len(samples) for samples in ours)
    label = f"{condition}, {count} stops"
    rows = [compare(f"{label}: {by.__name__}", "ms", ours, theirs, baseline=STOCK, by=by) for by in (p50, p99)]
    for by in (p99, max):
        figure = by([sample for samples in ours for sample in samples])
        rows.append(Row(what=f"{label}: {by.__name__} of all", unit="ms", ours=figure, baseline="one policy step",
                        theirs=_STEP_MS, ratio=figure / _STEP_MS, target=Target(limit=1.0, of="ratio")))  # fmt: skip
    return rows


@contextlib.contextmanager
def _station() -> Iterator[BusAddress]:
    """Run a bus and a G1 server."""
    with contextlib.ExitStack() as stack:
        address, _ = stack.enter_context(processes.bus())
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="bench-")))
        environment, log = {"STATION_BUS": address.url, "XDG_STATE_HOME": str(folder)}, folder / "g1.log"
        process = stack.enter_context(processes.station("serve", "g1", environment=environment, log=log))
        wait_active(address, "g1", process.pid, log)
        yield address


def _walk(stop: Stop, address: BusAddress) -> None:
    """Command a walk; after each stop of the robot be silent for as long as it wants, then begin anew."""
    motion, command_format = (
        registry.find("loader", "motion")("builtin:walk-forward"),
        registry.find("command", "twist2"),
    )
    with Bus(address, name="motion") as line, line.watch([keys.command_gate(ROBOT)]) as watch:
        playback = Playback(motion, command_format, loop=True)
        while not stop():
            gate = codec.parse_json(sample.value) if (sample := watch.latest(keys.command_gate(ROBOT))) else {}
            if gate.get("state") == "stopped" or gate.get("needs_silence"):
                playback = Playback(motion, command_format, loop=True)
            else:
                line.publish({command_format.key: codec.json_vector(playback.step(1 / _LOOP_HZ).command)})
            time.sleep(1 / _LOOP_HZ)


def _stops(address: BusAddress, count: int) -> list[float]:
    """Stop and release the robot so often; return how long each stop took [ms]."""
    random, found = Random(count), []
    with contextlib.closing(open_tap(address, backend="replication")) as tap, Bus(address, name="bench") as line:
        steps = _steps(tap)
        for _ in range(count):
            pause_s = random.uniform(*_PAUSE_S)
            _until(steps, lambda step: step.follows)
            time.sleep(pause_s)
            written_ns = time.monotonic_ns()
            line.publish({keys.ESTOP: b"1"})
            damped = _until(steps, lambda step: step.is_damped)
            found.append((damped.sent_ns - written_ns) * 1e-6)
            line.publish({keys.ESTOP: b"0"})
            _until(steps, lambda step: not step.is_stopped)
    return found


def _until(steps: Iterator[_Step], holds: Callable[[_Step], bool]) -> _Step:
    end_s = time.monotonic() + _GIVE_UP_S
    for step in steps:
        if holds(step):
            return step
        if time.monotonic() > end_s:
            break
    raise RuntimeError(f"the robot did not do so within {_GIVE_UP_S:g} s")


def _steps(tap: Tap) -> Iterator[_Step]:
    gate, stiffness = "", True
    while True:
        for write in tap.read(0.05):
            if write.value is None:
                continue
            if write.key == keys.command_gate(ROBOT):
                gate = codec.parse_json(write.value)["state"]
            elif write.key == keys.target(ROBOT):
                values = codec.parse_f64(write.value)
                stiffness = bool(values[len(values) // 3 : 2 * len(values) // 3].any())
            elif write.key == keys.policy_timing(ROBOT):
                sent_ns = int(codec.parse_json_vector(write.value)[2 + TIMING_STAGES.index("sent")])
                yield _Step(sent_ns, gate == "stopped", not stiffness, gate in ("entering", "tracking"))


def _press_stock(stop: Stop, port: int) -> None:
    """Write the instant as the value of the key, at random moments."""
    import redis

    client, random = redis.Redis(host="localhost", port=port), Random(1)
    while not stop():
        time.sleep(random.uniform(*_PAUSE_S))
        client.set(keys.ESTOP, time.monotonic_ns())
    client.close()


@contextlib.contextmanager
def _stock_reader(port: int) -> Iterator[Callable[[float], list[float]]]:
    """Run stock's loop in this process; yields what runs it for so many seconds."""
    infer, client = network.step(), stock.Client(port)

    def act(seconds: float) -> list[float]:
        found: list[float] = []
        newest = client.read([keys.ESTOP])[0]

        def tick() -> None:
            nonlocal newest
            value = client.read([keys.ESTOP])[0]
            infer()
            if value is not None and value != newest:
                found.append((time.monotonic_ns() - int(value)) * 1e-6)
            newest = value

        while not found:
            stock.loop(_LOOP_HZ, round(seconds * _LOOP_HZ), tick)
        return found

    yield act
    client.close()


BENCHMARK = Benchmark(name="estop", title="From emergency stop to damped joints", method=METHOD, run=run)
