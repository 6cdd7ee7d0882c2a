"""A robot's loop comes to tick just behind its commander, whatever the offset that they were started with."""

from __future__ import annotations

import numpy as np
import pytest

from tests.virtual.clock import VirtualClock
from tests.virtual.network import Network
from tests.virtual.station import ControlledRobot, Walk, commander


@pytest.mark.parametrize("what", ["motion", "teleop"])
@pytest.mark.parametrize("offset_s", [0.003, 0.011, 0.019])
def test_a_command_is_used_within_two_milliseconds_of_its_arrival(
    clock: VirtualClock, network: Network, robot: ControlledRobot, what: str, offset_s: float
) -> None:
    clock.sleep(offset_s)
    commander(network, "first", what, Walk(0.5, 0.1))
    clock.until(lambda: robot.state == "tracking")
    clock.sleep(6.0)
    seen = len(robot.ticks)
    clock.sleep(4.0)
    ages_s = np.array([tick.record.decision.age_s for tick in robot.ticks[seen:]])
    assert len(ages_s) == pytest.approx(200, abs=1)
    assert np.median(ages_s) < 0.002
    assert set(tick.state for tick in robot.ticks[seen:]) == {"tracking"}
