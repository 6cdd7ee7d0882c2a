"""Benchmark: from a write of the command to the policy process that uses it."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator

import msgspec

from benchmarks import commands, network, processes, stock
from benchmarks.harness import Benchmark, Rounds, Row, Settings, Target, alternate, compare, mean, p50, p99
from station.bus import codec
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.control.phase_lock import PhaseLock
from station.life.loop import Rate, real_time

_WRITER_HZ, _LOOP_HZ = 97.0, 50.0  # no common period: the phase between them sweeps
_SETTLE_S = 4.0  # until a loop that follows its commander stands where it should
STOCK, PLAIN, FIFO, FOLLOWS = "stock poll each cycle", "Watch", "Watch, FIFO", "Watch, FIFO, follows 50 Hz"

METHOD = """\
A process writes the command at 97 Hz, another runs a 50 Hz loop with the policy's network (or 0.5 ms of work where
there is no upstream data), so the phase between them sweeps. *Arrival*: from the writer's clock before the write to
the value being in the policy process. *Age at use*: the same clock to the instant the loop uses it; with loops that
run free it is uniform over a writer's period whatever the transport. *Follows*: the writer runs at 50 Hz, and the loop
moves its ticks to just behind the writes, as a robot's does. Baseline: stock's pipeline of GETs in each cycle with
relative sleeps, its writer's pipeline of SETs; the time rides in `t_action`. *Cost*: time of the loop's thread from
asking for the command to having its numbers.
*CPU*: of the whole policy process, `Watch`'s thread included. *Loaded*: a process of normal priority on every core.
*FIFO*: writer, Redis server and policy under SCHED_FIFO, as the station's servers ask for; left out where that is not
permitted. The other rows and the baseline run without."""


class Seen(msgspec.Struct):
    """What a reader saw in a round [ms], and its share of a core."""

    arrival_ms: list[float]
    age_ms: list[float]
    cost_ms: list[float]
    cpu_percent: float


def run(settings: Settings) -> list[Row]:
    """Measure."""
    seconds = settings.pick(6.0, 1.0)
    rows: list[Row] = []
    with contextlib.ExitStack() as stack:
        workers = {STOCK: _start_stock(stack), PLAIN: _start(stack)}
        if processes.fifo_is_permitted():
            workers |= {FIFO: _start(stack, is_fifo=True)}
            workers |= {FOLLOWS: _start(stack, is_fifo=True, follows=True)}
        for condition, beside in (("quiet", processes.nothing), ("loaded", processes.burners)):
            with beside():
                turns = {name: _turn(worker, seconds) for name, worker in workers.items()}
                rows += _rows(condition, alternate(turns, settings.rounds))
    return rows


def _start(stack: contextlib.ExitStack, *, is_fifo: bool = False, follows: bool = False) -> processes.Worker:
    """Start a bus, a writer and a reader of ours; a bus of its own, so that no contender disturbs another."""
    address, _ = stack.enter_context(processes.bus(is_fifo=is_fifo))
    writer_hz = _LOOP_HZ if follows else _WRITER_HZ
    stack.enter_context(processes.Beside(commands.write_native, address, writer_hz, is_fifo))
    return stack.enter_context(processes.Worker(reader, address, is_fifo, follows))


def _start_stock(stack: contextlib.ExitStack) -> processes.Worker:
    _, port = stack.enter_context(processes.bus(is_fifo=False))
    stack.enter_context(processes.Beside(commands.write_stock, port, _WRITER_HZ))
    return stack.enter_context(processes.Worker(stock_reader, port))


@contextlib.contextmanager
def reader(address: BusAddress, is_fifo: bool, follows: bool) -> Iterator[Callable[[float], Seen]]:
    """Run our loop in this process; yields what runs it for so many seconds."""
    infer, rate, phase = network.step(), Rate(_LOOP_HZ), PhaseLock(1.0 / _LOOP_HZ)
    with Bus(address, name="bench-policy") as line, line.watch(stock.COMMAND_KEYS) as watch:
        if is_fifo:
            real_time()
        body = stock.COMMAND_KEYS[0]

        def act(seconds: float) -> Seen:
            if follows and not phase.is_locked:
                measure(_SETTLE_S)
            return measure(seconds)

        def measure(seconds: float) -> Seen:
            seen, newest = Seen([], [], [], 0.0), watch.latest(body)
            began_s, began_cpu_s = time.monotonic(), time.process_time()
            for _ in range(round(seconds * _LOOP_HZ)):
                rate.wait()
                asked_ns = time.monotonic_ns()
                for key in stock.COMMAND_KEYS:
                    sample = watch.latest(key)
                    if sample is not None:
                        codec.parse_json_vector(sample.value)
                now_ns = time.monotonic_ns()
                seen.cost_ms.append((now_ns - asked_ns) * 1e-6)
                sample = watch.latest(body)
                if sample is not newest and sample is not None and sample.stamp and sample.arrived_ns:
                    seen.arrival_ms.append((sample.arrived_ns - sample.stamp.mono_ns) * 1e-6)
                    seen.age_ms.append((now_ns - sample.stamp.mono_ns) * 1e-6)
                    if follows:
                        rate.shift(phase.on_tick(sample.stamp.source, (now_ns - sample.arrived_ns) * 1e-9))
                newest = sample
                infer()
            seen.cpu_percent = _share(began_s, began_cpu_s)
            return seen

        yield act


@contextlib.contextmanager
def stock_reader(port: int) -> Iterator[Callable[[float], Seen]]:
    """Run stock's loop in this process; yields what runs it for so many seconds."""
    infer, client = network.step(), stock.Client(port)

    def act(seconds: float) -> Seen:
        seen = Seen([], [], [], 0.0)
        newest = 0

        def tick() -> None:
            nonlocal newest
            asked_ns = time.monotonic_ns()
            _, written_ns = client.read_command_and_time()
            now_ns = time.monotonic_ns()
            seen.cost_ms.append((now_ns - asked_ns) * 1e-6)
            if written_ns != newest:
                seen.arrival_ms.append((now_ns - written_ns) * 1e-6)
                seen.age_ms.append((now_ns - written_ns) * 1e-6)
            newest = written_ns
            infer()

        began_s, began_cpu_s = time.monotonic(), time.process_time()
        stock.loop(_LOOP_HZ, round(seconds * _LOOP_HZ), tick)
        seen.cpu_percent = _share(began_s, began_cpu_s)
        return seen

    yield act
    client.close()


def _share(began_s: float, began_cpu_s: float) -> float:
    return 100.0 * (time.process_time() - began_cpu_s) / (time.monotonic() - began_s)


def _turn(worker: processes.Worker, seconds: float) -> Callable[[], Seen]:
    return lambda: worker.ask(seconds)


def _rows(condition: str, taken: dict[str, list[Seen]]) -> list[Row]:
    def of(name: str, field: str) -> Rounds:
        return [getattr(seen, field) for seen in taken[name]]

    rows = []
    for name in [name for name in taken if name != STOCK]:
        arrival_p99_ms = 1.0 if name == PLAIN else 0.6
        label = f"{name}, {condition}"
        for field, by, target in (
            ("arrival_ms", p50, Target(limit=0.45) if condition == "quiet" else None),
            ("arrival_ms", p99, Target(limit=arrival_p99_ms)),
            ("age_ms", p50, Target(limit=2.0) if (name, condition) == (FOLLOWS, "quiet") else None),
            ("age_ms", p99, None if name == FOLLOWS else Target(limit=11.0)),
            ("cost_ms", p50, Target(limit=0.15)),
        ):
            what = {"arrival_ms": "arrival", "age_ms": "age at use", "cost_ms": "cost in the cycle"}[field]
            rows.append(compare(f"{label}: {what} {by.__name__}", "ms", of(name, field), of(STOCK, field),
                                baseline=STOCK, by=by, target=target))  # fmt: skip
        shares = {n: [[seen.cpu_percent] for seen in taken[n]] for n in (name, STOCK)}
        rows.append(compare(f"{label}: CPU", "%", shares[name], shares[STOCK], baseline=STOCK, by=mean))
    return rows


BENCHMARK = Benchmark(name="wake", title="From command to policy", method=METHOD, run=run)
