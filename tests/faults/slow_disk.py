"""A robot at work beside a recorder, and when its loop read the robot's state."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from adapters.robots.g1 import twist_keys
from station.bus import keys
from station.bus.address import BusAddress
from station.contract import TIMING_STAGES
from station.protocols import Floats
from tests.faults.recorded_station import RecordedStation, recorded_station
from tests.servers.g1_station import G1Process, Log, StockCommander, logged
from tests.waiting import wait_until

TIMING = keys.policy_timing(twist_keys.TWIST2_ROBOT)
_READ = 2 + TIMING_STAGES.index("state_read")


@contextmanager
def robot_beside_a_recorder(address: BusAddress, folder: Path, *robot: str) -> Iterator[tuple[Log, RecordedStation]]:
    """A simulated robot that follows a stock commander, and a recorder; `robot` are settings of the robot's server."""
    with (
        G1Process(address, *robot),
        logged(address) as log,
        recorded_station(address, folder) as station,
        StockCommander(address),
    ):
        wait_until(lambda: log.values(TIMING))
        yield log, station


def ticks_made(log: Log, count: int) -> Floats:
    """Wait for so many steps; return when each read its state [s]."""
    first = len(log.values(TIMING))
    wait_until(lambda: len(log.values(TIMING)) >= first + count)
    return np.array([json.loads(value)[_READ] for value in log.values(TIMING)[first : first + count]]) * 1e-9
