"""A bus, a supervisor and a data folder for each test."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from station.bus.address import BusAddress
from station.bus.client import Bus
from tests.supervision.place import Place


@pytest.fixture
def place(bus_server: BusAddress, tmp_path: Path) -> Iterator[Place]:
    with Bus(bus_server, name="supervisor", timeout_s=5.0) as bus:
        made = Place(bus, tmp_path)
        try:
            yield made
        finally:
            made.supervisor.stop_all()
