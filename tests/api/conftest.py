"""A station with a robot, a recorder and a motion that waits for its start, for scripts."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from station.life.stop_button import StopButton
from tests.cli.running import Home, new_home
from tests.waiting import DEADLINE_S, wait_until

WAITING = ("motion.wait_for_start=true", "motion.loop=true", "motion.enter_s=0.3", "motion.leave_s=0.3")


@contextmanager
def station_that_waits() -> Iterator[Home]:
    """Run such a station on a bus of its own: a stop ends the motion, and with it a station that nobody attends."""
    settings = [word for setting in WAITING for word in ("--set", setting)]
    with new_home() as home, home.running("bus", "start") as bus:
        wait_until(home.bus_is_there)
        with home.running("up", "g1-sim-motion", "--yes", *settings) as station:
            station.wait_for("✓ start motion")
            yield home
            station.interrupt()
            station.finish()
        bus.interrupt()
        bus.finish()


@pytest.fixture
def patient_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stop waits for its robots as long as a test does, and not a second."""
    for wait in (StopButton.unstopped, StopButton.unreleased):
        monkeypatch.setattr(wait, "__defaults__", (DEADLINE_S,))


@pytest.fixture(scope="package")
def common(processes: None) -> Iterator[Home]:
    """A place where one runs that nobody stops."""
    with station_that_waits() as home:
        yield home


@pytest.fixture
def own(processes: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[Home]:
    """A place where one runs for a test alone, found by itself as in a terminal there."""
    with station_that_waits() as home:
        find(home, monkeypatch)
        yield home


@pytest.fixture
def shared(common: Home, monkeypatch: pytest.MonkeyPatch) -> Home:
    """The common one, found by itself."""
    find(common, monkeypatch)
    return common


def find(home: Home, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STATION_BUS", home.bus.url)
    monkeypatch.setenv("STATION_DATA", str(home.data))
