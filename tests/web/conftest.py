"""Fixtures of the console's tests."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from station.bus.address import BusAddress
from station.bus.client import Bus
from tests.web import browser as browsers
from tests.web.browser import DESKTOP, Page
from tests.web.console_process import ConsoleProcess, PageSocket

StartConsole = Callable[..., ConsoleProcess]
Open = Callable[..., Page]


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


@pytest.fixture(scope="module")
def driver(processes: None) -> Iterator[Any]:
    """What drives browsers."""
    browsers.expect_browser()
    with browsers.driven() as found:
        yield found


@pytest.fixture(scope="module")
def browser(driver: Any) -> Iterator[Any]:
    """A browser."""
    with browsers.opened(driver) as found:
        yield found


@contextlib.contextmanager
def _pages(browser: Any) -> Iterator[Open]:
    with contextlib.ExitStack() as stack:
        opened: list[Page] = []

        def begin(link: str, size: tuple[int, int] = DESKTOP, **more: Any) -> Page:
            made = Page(browser, link, size, **more)
            stack.callback(made.close)
            opened.append(made)
            return made

        yield begin
        assert [trouble for page in opened for trouble in page.trouble] == []


@pytest.fixture
def open_page(browser: Any) -> Iterator[Open]:
    """Open pages that are closed at the end, and in which nothing went wrong."""
    with _pages(browser) as begin:
        yield begin


@pytest.fixture(scope="module")
def drawing_browser(driver: Any) -> Iterator[Any]:
    """A browser with WebGL."""
    with browsers.opened(driver, draws=True) as found:
        yield found


@pytest.fixture
def open_drawn(drawing_browser: Any) -> Iterator[Open]:
    """As `open_page`, with the robot in 3D."""
    with _pages(drawing_browser) as begin:
        yield begin
