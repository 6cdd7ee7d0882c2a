"""A bus as `station bus start --tcp PORT` opens it for stock scripts, and servers of ours on it."""

from __future__ import annotations

import signal
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from station.bus.address import BusAddress
from station.bus.client import Bus
from station.life.server import Health, read_health
from tests.bus.tap.traffic import free_port
from tests.main_job.station_runs import Terminal
from tests.waiting import DEADLINE_S, bus_answers, wait_until


@dataclass(frozen=True)
class OpenBus:
    """A bus with our socket and a loopback port for the scripts of others."""

    terminal: Terminal
    address: BusAddress
    port: int


@pytest.fixture(scope="module")
def open_bus(processes: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[OpenBus]:
    """One server per module; a test empties it."""
    terminal, port = Terminal(tmp_path_factory.mktemp("stock")), free_port()
    process = terminal.start("bus", "start", "--tcp", str(port))
    address = BusAddress(socket=f"{terminal.environment['XDG_RUNTIME_DIR']}/station/bus.sock")
    try:
        wait_until(lambda: bus_answers(address))
        yield OpenBus(terminal, address, port)
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=DEADLINE_S)


@pytest.fixture
def bus(open_bus: OpenBus) -> Iterator[Bus]:
    """Our own line to a bus that was emptied for this test."""
    with Bus(open_bus.address, name="witness", timeout_s=5.0) as line:
        line.call("FLUSHALL")
        yield line


Serve = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def serve(open_bus: OpenBus, bus: Bus) -> Iterator[Serve]:
    """Starts a server of ours and waits until it is active; none outlives the test."""
    started: list[subprocess.Popen[str]] = []

    def start(server: str, *settings: str) -> subprocess.Popen[str]:
        sets = [word for setting in settings for word in ("--set", setting)]
        process = open_bus.terminal.start("serve", server, *sets)
        started.append(process)
        wait_until(lambda: process.poll() is not None or _is_active(bus, process))
        assert process.poll() is None, process.communicate()[0]
        return process

    yield start
    for process in reversed(started):
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()  # not `communicate`: that of a server that died at its start has been read


def finish(process: subprocess.Popen[str]) -> str:
    """Ask a server to stop; return its log."""
    process.send_signal(signal.SIGTERM)
    output, _ = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0, output
    return output


def health(bus: Bus, name: str) -> Health:
    """Return what a server says of itself."""
    (found,) = [item for item in read_health(bus) if item.name == name]
    return found


def _is_active(bus: Bus, process: subprocess.Popen[str]) -> bool:
    return any(item.pid == process.pid and item.state == "active" for item in read_health(bus))
