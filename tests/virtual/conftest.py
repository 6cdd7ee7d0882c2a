"""A bus and a robot in virtual time, for tests of one course of events."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest

from station.bus.client import Bus
from station.bus.connection import Connection
from tests.virtual.clock import VirtualClock
from tests.virtual.network import Network
from tests.virtual.station import ControlledRobot
from tests.virtual.trial import alone


@pytest.fixture
def clock() -> Iterator[VirtualClock]:
    """Virtual time, in which threads wake up to 0.2 ms late."""
    with alone(), VirtualClock(late_ns=200_000) as made:
        yield made


@pytest.fixture
def network(clock: VirtualClock, caplog: pytest.LogCaptureFixture) -> Network:
    """A bus 10 to 300 us away."""
    caplog.set_level(logging.ERROR, "station")
    return Network(clock, latency_ns=(10_000, 300_000))


@pytest.fixture
def bus(network: Network) -> Iterator[Bus]:
    """An operator's line to the bus."""
    with Bus(network.address(), name="ada", timeout_s=1.0) as line:
        yield line


@pytest.fixture
def line(network: Network) -> Iterator[Connection]:
    """A script's line to the bus."""
    connection = Connection(network.address(), timeout_s=1.0)
    yield connection
    connection.close()


@pytest.fixture
def robot(clock: VirtualClock, network: Network) -> ControlledRobot:
    """A simulated robot that runs, armed."""
    made = ControlledRobot(network)
    clock.until(lambda: len(made.ticks) > 5)
    return made


@pytest.fixture
def disarmed(clock: VirtualClock, network: Network) -> ControlledRobot:
    """A real robot that runs, disarmed."""
    made = ControlledRobot(network, is_simulated=False)
    clock.until(lambda: len(made.ticks) > 5)
    return made
