"""The LCM bridge on a bus with a user per role: as what user it commands their robot, and says where that is."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.bus import codec, keys
from station.bus.client import Bus
from tests.security.conftest import As
from tests.servers.lcm_station import lcm_station

LEGS = "g1_29_legs"


@pytest.mark.usefixtures("processes")
@pytest.mark.parametrize("role", ["command", "low-level"])
def test_it_commands_as_either_and_says_where_the_robot_is_as_the_user_who_may(
    as_role: As, tmp_path: Path, role: str
) -> None:
    used, key = keys.command_used(LEGS), keys.action(f"velocity-height_{LEGS}")
    with lcm_station(as_role("recorder"), tmp_path) as bridge, Bus(as_role("command"), name="commander") as bus:
        bridge.start(mode="our-cockpit", url=as_role(role).url)

        def walks() -> bool:
            bus.publish({key: codec.json_vector([0.5, 0.0, 0.0, 0.74])})
            return bridge.detail["channels"]["pedal_command"]["sent"] > 20

        bridge.until(walks)
        assert bus.lost_writes == 0
        assert (bus.get(used) is not None) == (role == "low-level")
        assert bool(bridge.told("lcm-says-not-where")) == (role == "command")
        assert bridge.told("bus-refused") == []
