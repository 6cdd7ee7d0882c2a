"""Stations that several tests look at, and a place for those that need their own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from station.bus import keys
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from tests.cli.running import COMMANDS_ONLY, SHORT, Home, Running, new_home
from tests.lateness import TooLate, Waits, in_time

SLOWEST_HZ = 45.0  # of a motion server, which is to write at 50


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
    """A finished run of the built-in wave, with its episode; its motion server kept its time."""
    with ExitStack() as homes:
        yield in_time(lambda: wave_once(homes.enter_context(new_home())))


def wave_once(home: Home) -> Wave:
    arguments = ("--yes", "--record", "--task", "wave", "--instruction", "wave your hand", "--operator", "ada")
    with Waits.watched() as waits, home.running("up", COMMANDS_ONLY, *arguments, *SHORT) as station:
        made = Wave(home, station)
    assert made.code == 0, station.text
    (body,) = (stream for stream in check(open_episode(made.episode)).streams if stream.key == keys.action_body())
    if body.rate_hz is not None and body.rate_hz <= SLOWEST_HZ:
        late_s = (1 - body.rate_hz / SLOWEST_HZ) * body.count / SLOWEST_HZ
        raise TooLate(f"commands at {body.rate_hz:.1f} Hz", late_s, waits.seconds())
    return made
