"""Benchmark: from an operator's headset to whoever reads the bus."""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec

from adapters.devices.fakes.pico.play import Wearer
from adapters.devices.fakes.pico.script import Script
from adapters.devices.fakes.pico.service import PicoService
from benchmarks import processes, stock
from benchmarks.harness import Benchmark, Rounds, Row, Settings, Target, alternate, compare, mean, p50, p99
from station import python_child
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.life.loop import Rate

_SENT_HZ, _LOOKS_HZ = 72.0, 100.0
OURS, BARE = "pico server", "bare library polled at 100 Hz"

METHOD = """\
A fake PC service sends head, two controllers and a body of 24 joints 72 times a second; the real `xrobotoolkit-sdk`
takes them. *Ours*: the Pico server looks at it 100 times a second and writes each new sample to the bus, from which
another process's `Watch` has it. Baseline: a process that polls the same library at 100 Hz with relative sleeps, reads
everything and hands it to nobody. The time is from the service's call to the value being at hand, on one machine's
monotonic clock; about 5 ms of it is waiting for the next look. *Samples*: new ones per second, of 72 that are sent.
*CPU*: of the whole process, the library's ten threads included."""


class Seen(msgspec.Struct):
    """What a contender saw in a round."""

    latency_ms: list[float]
    samples_hz: float
    cpu_percent: float


def run(settings: Settings) -> list[Row]:
    """Measure."""
    seconds = settings.pick(6.0, 1.0)
    with contextlib.ExitStack() as stack:
        address, _ = stack.enter_context(processes.bus())
        port = processes.free_port()
        stack.enter_context(processes.Beside(send, port))
        server = stack.enter_context(_server(address, port))
        reader = stack.enter_context(processes.Worker(read_bus, address, server.pid))
        poller = stack.enter_context(processes.Worker(poll, port))
        turns = {OURS: lambda: reader.ask(seconds), BARE: lambda: poller.ask(seconds)}
        return _rows(alternate(turns, settings.rounds))


def send(stop: processes.Stop, port: int) -> int:
    """Send frames, stamped with the monotonic clock as they go, until told to stop; return how many."""
    script = msgspec.convert({"motion": "builtin:wave", "repeat": "swing", "rate_hz": _SENT_HZ}, Script)
    wearer, rate, count = Wearer(script), Rate(_SENT_HZ), 0
    with PicoService(port) as service:
        while not stop():
            frame = dict(wearer.frame(count, 0) or {})
            rate.wait()
            frame["timeStampNs"] = frame["Body"]["timeStampNs"] = time.monotonic_ns()
            service.send(frame)
            count += 1
    return count


@contextlib.contextmanager
def read_bus(address: BusAddress, server_pid: int) -> Iterator[Callable[[float], Seen]]:
    """Read the bus in this process; yields what does it for so many seconds."""
    body = keys.operator_body_pos("pico")
    with Bus(address, name="bench-reader") as line, line.watch([body]) as watch:

        def act(seconds: float) -> Seen:
            seen, newest = Seen([], 0.0, 0.0), watch.latest(body)
            began_s, began_cpu_s = time.monotonic(), processes.cpu_s(server_pid)
            while (elapsed_s := time.monotonic() - began_s) < seconds:
                sample = watch.wait(body, after=newest, timeout_s=0.1)
                if sample is None or sample.stamp is None or sample.arrived_ns is None:
                    continue
                newest = sample
                seen.latency_ms.append((sample.arrived_ns - (sample.stamp.capture_ns or 0)) * 1e-6)
            seen.samples_hz = len(seen.latency_ms) / elapsed_s
            seen.cpu_percent = 100.0 * (processes.cpu_s(server_pid) - began_cpu_s) / elapsed_s
            return seen

        assert watch.wait(body, after=None, timeout_s=30.0) is not None, "the pico server writes nothing"
        yield act


@contextlib.contextmanager
def poll(port: int) -> Iterator[Callable[[float], Seen]]:
    """Poll the bare library in this process; yields what does it for so many seconds."""
    sdk = _bare_library(port)

    def act(seconds: float) -> Seen:
        seen, newest_ns = Seen([], 0.0, 0.0), 0
        began_s, began_cpu_s = time.monotonic(), time.process_time()

        def tick() -> None:
            nonlocal newest_ns
            _read_everything(sdk)
            stamp_ns = sdk.get_time_stamp_ns()
            if stamp_ns != newest_ns:
                newest_ns = stamp_ns
                seen.latency_ms.append((time.monotonic_ns() - stamp_ns) * 1e-6)

        stock.loop(_LOOKS_HZ, round(seconds * _LOOKS_HZ), tick)
        elapsed_s = time.monotonic() - began_s
        seen.samples_hz = len(seen.latency_ms) / elapsed_s
        seen.cpu_percent = 100.0 * (time.process_time() - began_cpu_s) / elapsed_s
        return seen

    yield act
    sdk.close()


def _bare_library(port: int) -> Any:
    sdk = importlib.import_module("xrobotoolkit_sdk")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "PXREASetting.ini").write_text(f"[Client]\nconnectAddr=127.0.0.1\nconnectPort={port}\n")
        os.chdir(folder)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sdk.init()
        os.chdir("/")
    while not sdk.get_time_stamp_ns():
        time.sleep(0.01)
    return sdk


def _read_everything(sdk: Any) -> None:
    sdk.get_headset_pose()
    sdk.get_body_joints_pose()
    for side in ("left", "right"):
        for what in ("controller_pose", "trigger", "grip", "axis", "axis_click", "menu_button"):
            getattr(sdk, f"get_{side}_{what}")()
    for button in "ABXY":
        getattr(sdk, f"get_{button}_button")()


_SERVE = """
import json, sys
from adapters.devices.pico.kind import KIND, PicoConfig
from station.bus.address import parse
from station.life.serving import serve
sys.exit(serve(KIND.server, PicoConfig(**json.loads(sys.argv[2])), address=parse(sys.argv[1])))
"""


@contextlib.contextmanager
def _server(address: BusAddress, port: int) -> Iterator[subprocess.Popen[bytes]]:
    config = json.dumps({"port": port, "rate_hz": _LOOKS_HZ})
    command = python_child.command("-c", _SERVE, address.url, config)
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:  # its events are on the bus
        try:
            yield process
        finally:
            process.terminate()


def _rows(taken: dict[str, list[Seen]]) -> list[Row]:
    def of(name: str, field: str) -> Rounds:
        values = [getattr(seen, field) for seen in taken[name]]
        return [value if isinstance(value, list) else [value] for value in values]

    def row(what: str, unit: str, field: str, **more: Any) -> Row:
        return compare(what, unit, of(OURS, field), of(BARE, field), baseline=BARE, **more)

    return [
        row("headset to bus reader: p50", "ms", "latency_ms", by=p50, target=Target(limit=8.0)),
        row("headset to bus reader: p99", "ms", "latency_ms", by=p99, target=Target(limit=16.0)),
        row("samples", "1/s", "samples_hz", by=mean, target=Target(limit=0.98, sense=">=", of="ratio")),
        row("CPU", "%", "cpu_percent", by=mean),
    ]


BENCHMARK = Benchmark(name="devices", title="From a headset to the bus", method=METHOD, run=run)
