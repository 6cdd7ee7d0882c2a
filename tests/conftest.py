"""What every test may ask for: upstream data, and a real server of its own."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from station.bus.address import BusAddress
from tests.lateness import EXCUSED


def pytest_configure() -> None:
    """Hear Ctrl-C, so that every child does: a shell's background job, and all that it starts, would ignore it."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    # How long an example takes is the machine's business.
    settings.register_profile("patient", settings(), deadline=None, suppress_health_check=[HealthCheck.too_slow])
    settings.load_profile("patient")


def pytest_runtest_setup(item: pytest.Item) -> None:
    """See that there is upstream data for a test that is marked with `assets`, before any of its fixtures."""
    if item.get_closest_marker("assets"):
        _upstream_data()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say where a round was repeated because the machine was proven late, see tests/lateness.py."""
    for report in terminalreporter.getreports("passed"):
        for line in report.caplog.splitlines():
            if EXCUSED in line:
                terminalreporter.write_line(f"{report.nodeid}: {line}")


@pytest.fixture(scope="session")
def assets() -> Path:
    """Folder with upstream data; for tests that are marked with `assets`."""
    return _upstream_data()


def _upstream_data() -> Path:
    """Return the folder; a machine without it skips, CI fails."""
    value = os.environ.get("STATION_ASSETS")
    if value and Path(value).is_dir():
        return Path(value)
    message = "STATION_ASSETS does not name a folder with upstream data"
    if os.environ.get("CI"):
        pytest.fail(message)
    pytest.skip(message)


@pytest.fixture(scope="session", autouse=True)
def _own_cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Compile robot models into a cache of this test run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(autouse=True)
def _own_runtime_folder(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep every test away from a station that the user may be running."""
    folder = tmp_path_factory.mktemp("run")
    folder.chmod(0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    bus = ("", "_USER", "_PASSWORD", "_PASSWORD_FILE", "_CA", "_CERT", "_KEY")
    for name in (*(f"STATION_BUS{suffix}" for suffix in bus), "STATION_DATA"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(autouse=True)
def _ordinary_scheduling() -> Iterator[None]:
    """See that no test leaves real-time scheduling to those after it: their children would starve everybody else."""
    yield
    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK != os.SCHED_OTHER:
        found = f"policy {os.sched_getscheduler(0)}, priority {os.sched_getparam(0).sched_priority}"
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        pytest.fail(f"the test leaves its process with real-time scheduling ({found})")


@pytest.fixture
def bus_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BusAddress]:
    """Address of a real server in a folder of its own."""
    from station.bus.redis_server import RedisServer, ServerOptions

    folder = tmp_path_factory.mktemp("bus")
    with RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock")) as server:
        yield server.address


@pytest.fixture(scope="session")
def kord() -> Any:
    """The native bridge to Kassow controllers, with their simulator; a machine without it skips, CI fails."""
    try:
        import station_kord
    except ImportError as error:
        message = f"station_kord is not built ({error}): pip install ./bridges/kord"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return station_kord
