"""What a robot went through is told as it was, however late the asker comes to look."""

from __future__ import annotations

from typing import Any

import pytest

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.life import arm_request
from station.life.arm_request import ArmRequest


@pytest.mark.parametrize(("began", "states"), [(True, ["arming", "armed"]), (False, ["armed"])])
def test_arming_that_was_over_before_anybody_looked_was_arming(
    bus_server: BusAddress, began: bool, states: list[str]
) -> None:
    wanted, key = ArmRequest(action="arm", id="a"), keys.command_gate("r")
    answer: dict[str, Any] = {"id": "a", "action": "arm", "refused": "", "began": began}
    gate = {"state": "waiting", "arming": "armed", "arm": answer}
    with Bus(bus_server, name="g1", timeout_s=5.0) as bus, bus.watch([key]) as watch:
        bus.publish({key: codec.json_object(gate)})
        assert arm_request._follow(watch, "g1", key, wanted, bus.clock.monotonic_s() + 60.0) == states
