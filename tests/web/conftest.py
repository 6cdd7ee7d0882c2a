"""Fixtures of the console's tests."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from station.bus.address import BusAddress
from station.bus.client import Bus
from tests.web.console_process import ConsoleProcess, PageSocket

StartConsole = Callable[..., ConsoleProcess]


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    """A client of the bus."""
    with Bus(bus_server, name="test", timeout_s=5.0) as client:
        yield client


@pytest.fixture
def start_console(processes: None, bus_server: BusAddress, tmp_path: Path) -> Iterator[StartConsole]:
    """Start consoles that are killed at the end."""
    with contextlib.ExitStack() as stack:

        def begin(*more: str, address: BusAddress = bus_server, port: int = 0) -> ConsoleProcess:
            made = ConsoleProcess(address, tmp_path, *more, port=port)
            stack.callback(made.kill)
            return made

        yield begin


@pytest.fixture
def closing() -> Iterator[Callable[[PageSocket], PageSocket]]:
    """Close pages at the end."""
    with contextlib.ExitStack() as stack:

        def keep(page: PageSocket) -> PageSocket:
            stack.callback(page.close)
            return page

        yield keep
