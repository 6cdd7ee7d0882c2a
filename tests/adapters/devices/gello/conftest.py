"""Ports with fake servos, of the fixture `servos` of each file: in memory and virtual time, and a pseudo terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from adapters.devices.fakes.gello.port import FakePort
from adapters.devices.fakes.gello.servos import Chain, Servo
from tests.adapters.devices.gello.serial_line import LinePort, lines_in_memory
from tests.virtual.clock import VirtualClock


@pytest.fixture
def clock() -> Iterator[VirtualClock]:
    with VirtualClock() as made:
        yield made


@pytest.fixture
def line(clock: VirtualClock) -> Iterator[Callable[..., LinePort]]:
    """Makes lines in memory; nothing else can be opened meanwhile."""
    with lines_in_memory(clock) as made:
        yield made


@pytest.fixture
def port(servos: list[Servo], tmp_path: Path, processes: object) -> Iterator[FakePort]:
    """A pseudo terminal: its servos answer from a thread, in real time."""
    fake = FakePort(tmp_path, "FT1", Chain(servos))
    yield fake
    fake.close()
