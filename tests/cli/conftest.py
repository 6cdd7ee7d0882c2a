"""Stations that several tests look at, and a place for those that need their own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.running import COMMANDS_ONLY, SHORT, Home, Running, new_home


@pytest.fixture
def home(processes: None) -> Iterator[Home]:
    """A place of its own, where nothing runs."""
    with new_home() as made:
        yield made


@pytest.fixture(scope="package")
def bus_home(processes: None) -> Iterator[Home]:
    """A place where a bus runs, and no server."""
    with new_home() as made, made.running("bus", "start") as bus:
        assert bus.process.stdout is not None
        assert bus.process.stdout.readline().startswith("bus unix://")
        yield made


@pytest.fixture(scope="package")
def live(processes: None) -> Iterator[Home]:
    """A place where a station without a robot runs for as long as it is looked at; nothing is being recorded."""
    with (
        new_home() as made,
        made.running("up", COMMANDS_ONLY, "--set", "motion.loop=true", *SHORT) as station,
    ):
        station.wait_for("✓ start motion")
        yield made
        station.interrupt()
        assert station.finish()[0] == 0, station.text


class Wave:
    """A run of the built-in wave from its beginning to its end, recorded."""

    def __init__(self, home: Home, station: Running) -> None:
        self.home, self.station = home, station
        self.code, self.out = station.finish()

    @property
    def episode(self) -> Path:
        return Path(self.out.strip())


@pytest.fixture(scope="package")
def wave(processes: None) -> Iterator[Wave]:
    """A finished run of the built-in wave, with its episode."""
    with new_home() as home:
        yield wave_once(home)


def wave_once(home: Home) -> Wave:
    arguments = ("--yes", "--record", "--task", "wave", "--instruction", "wave your hand", "--operator", "ada")
    with home.running("up", COMMANDS_ONLY, *arguments, *SHORT) as station:
        made = Wave(home, station)
    assert made.code == 0, station.text
    return made
