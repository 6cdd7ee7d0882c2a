"""Benchmark: what a cycle pays for the bus."""

from __future__ import annotations

import time
from collections.abc import Callable

from benchmarks import commands, processes, stock
from benchmarks.harness import Benchmark, Row, Settings, Target, alternate, compare, p50, p99
from station.bus import codec
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.clock import SYSTEM

_PERIOD_NS = 4_000_000
_WRITER_HZ = 97.0

METHOD = """\
Write: `Bus.publish` of body, two hands, neck and time, JSON made on the spot, beside stock's pipeline of five SETs.
Read: `Watch.latest` of four keys and the parsing of their JSON, beside stock's pipeline of four GETs and `json.loads`,
while another process writes them at 97 Hz. Ours goes through the unix socket and carries a stamp per key, stock's
through TCP. *Paced*: one call every 4 ms, with both ends asleep in between, as in a real loop; *hot*: back to back."""


def run(settings: Settings) -> list[Row]:
    """Measure."""
    with processes.bus() as (address, port):
        rows = _write(settings, address, port)
        with processes.Beside(commands.write_native, address, _WRITER_HZ):
            rows += _read(settings, address, port)
    return rows


def _write(settings: Settings, address: BusAddress, port: int) -> list[Row]:
    vectors = commands.vectors()
    client = stock.Client(port)
    with Bus(address, name="bench") as line:

        def ours() -> None:
            line.publish(commands.encoded(vectors, time.monotonic_ns()))

        def theirs() -> None:
            client.send_command(vectors, time.monotonic_ns())

        rows = _rows(settings, "write 5 keys", ours, theirs, "stock pipeline of 5 SETs")
    client.close()
    return rows


def _read(settings: Settings, address: BusAddress, port: int) -> list[Row]:
    client = stock.Client(port)
    with Bus(address, name="bench") as line, line.watch(stock.COMMAND_KEYS) as watch:
        for key in stock.COMMAND_KEYS:
            watch.wait(key, after=None, timeout_s=5.0)

        def ours() -> None:
            for key in stock.COMMAND_KEYS:
                sample = watch.latest(key)
                assert sample is not None
                codec.parse_json_vector(sample.value)

        rows = _rows(settings, "read 4 keys", ours, client.read_command, "stock pipeline of 4 GETs")
    client.close()
    return rows


def _rows(
    settings: Settings, what: str, ours: Callable[[], object], theirs: Callable[[], object], baseline: str
) -> list[Row]:
    paced_n, hot_n = int(settings.pick(400, 60)), int(settings.pick(3000, 200))
    paced = alternate({"o": lambda: _paced(ours, paced_n), "t": lambda: _paced(theirs, paced_n)}, settings.rounds)
    hot = alternate({"o": lambda: _hot(ours, hot_n), "t": lambda: _hot(theirs, hot_n)}, settings.rounds)
    tenth = Target(limit=0.15)
    return [
        compare(f"{what}, paced, p50", "ms", paced["o"], paced["t"], baseline=baseline, by=p50, target=tenth),
        compare(f"{what}, paced, p99", "ms", paced["o"], paced["t"], baseline=baseline, by=p99),
        compare(f"{what}, hot, p50", "ms", hot["o"], hot["t"], baseline=baseline, by=p50),
    ]


def _paced(call: Callable[[], object], count: int) -> list[float]:
    taken = []
    due_ns = time.monotonic_ns()
    for _ in range(count):
        due_ns += _PERIOD_NS
        SYSTEM.sleep_until(due_ns)
        taken.append(_timed_ms(call))
    return taken


def _hot(call: Callable[[], object], count: int) -> list[float]:
    return [_timed_ms(call) for _ in range(count)]


def _timed_ms(call: Callable[[], object]) -> float:
    began_ns = time.perf_counter_ns()
    call()
    return (time.perf_counter_ns() - began_ns) * 1e-6


BENCHMARK = Benchmark(name="bus", title="Bus", method=METHOD, run=run)
