"""A teleoperation server that is asked to stop while it drives says so, before the robot returns to standing."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.servers.operated_station import TIMEOUT_S, OperatedStation
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")


def test_a_stop_from_outside_ends_the_commands_in_an_event(tmp_path: Path) -> None:
    with OperatedStation(tmp_path, driver="walk") as station:
        station.engage()
        before = len(station.log.states())
        station.supervisor.children["teleop"].process.terminate()
        assert station.wait_for_end() == 0
        farewell = station.wait_for("teleop-commands-end")
        assert (farewell.severity, farewell.detail["reason"]) == ("info", "the server was asked to stop")
        wait_until(lambda: "returning" in station.log.states()[before:], TIMEOUT_S)
        assert station.is_upright()
