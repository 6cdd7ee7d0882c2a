"""A robot that starts disarmed, in its real server: what it is sent, and how it is armed.

When it may be armed, and what is told, is in `tests/virtual/test_arming.py`.
"""

from __future__ import annotations

import numpy as np

from station.bus import codec, keys
from station.bus.address import BusAddress
from tests.servers.g1_station import LIGHT, ROBOT, G1Process, StockCommander, logged
from tests.servers.g1_trials import arm
from tests.waiting import wait_until

DISARMED = (*LIGHT, "start_armed=false", "gate.return_after_s=1.5")
"""A busy machine may be late with a command; how long it takes until they have ceased is not the subject here."""


def test_a_disarmed_robot_gets_nothing_though_its_policy_follows_the_commands(bus_server: BusAddress) -> None:
    with logged(bus_server) as log, G1Process(bus_server, *DISARMED), StockCommander(bus_server):
        wait_until(lambda: log.gate()["state"] == "tracking")
        assert log.gate()["arming"] == "disarmed"
        sent = np.array([codec.parse_f64(value) for value in log.values(keys.target(ROBOT))])
        assert not sent[:, 29:].any(), "no stiffness, no damping"
        places = np.array([codec.parse_f64(value) for value in log.values(keys.sim_qpos(ROBOT))])
        assert (places == places[0]).all(), "the simulation hangs where it is"
        assert len(log.values(keys.policy_action(ROBOT))) > 10


def test_arming_ramps_the_stiffness_up_is_told_and_the_robot_stays_on_its_feet(bus_server: BusAddress) -> None:
    arm(bus_server, *DISARMED)
