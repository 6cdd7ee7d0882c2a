"""Two commanders on one key, as real processes: the robot follows one, and everybody hears of both.

How soon it is told is in `test_proof_two_writers`.
"""

from __future__ import annotations

import numpy as np

from station.bus import codec, keys
from station.bus.address import BusAddress
from tests.faults.rivals import (
    commander,
    refuse_a_stranger,
    refuse_ours,
    refuse_the_second,
    told_by_robot,
)
from tests.servers.g1_station import LEAVING, PATIENT, ROBOT, G1Process, StockCommander, logged
from tests.waiting import wait_until


def test_the_second_of_two_motion_servers_is_refused_and_takes_over_when_the_first_is_killed(
    bus_server: BusAddress,
) -> None:
    lost, _ = refuse_the_second(bus_server, *LEAVING)
    assert lost == []


def test_a_stock_script_beside_our_motion_server_is_refused_and_called_foreign(bus_server: BusAddress) -> None:
    assert refuse_a_stranger(bus_server, *PATIENT) == []


def test_in_lock_step_only_the_commands_of_who_is_obeyed_are_used(bus_server: BusAddress) -> None:
    with (
        logged(bus_server) as log,
        G1Process(bus_server, *PATIENT, "pace=command"),
        commander(bus_server, "ours", "builtin:walk-forward", "pace=state"),
    ):
        wait_until(lambda: log.gate()["state"] == "tracking")
        with StockCommander(bus_server):
            wait_until(lambda: told_by_robot(log))
            wait_until(lambda: log.gate()["refused"] > 20)
            timing = [codec.parse_json_vector(value) for value in log.values(keys.policy_timing(ROBOT))]
    sequence = np.array(timing)[:, 1]
    assert (sequence > 0).all(), "a foreign command has no number"
    assert (np.diff(sequence) >= 0).all()
    assert not log.events("command-handover")


def test_our_motion_server_beside_a_stock_script_is_refused(bus_server: BusAddress) -> None:
    assert refuse_ours(bus_server, *PATIENT) == []
