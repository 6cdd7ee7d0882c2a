"""Two commanders on one key, as real processes: the robot follows one, and everybody hears of both.

How soon it is told is in `test_proof_two_writers`.
"""

from __future__ import annotations

import signal

import numpy as np

from station.bus import codec, keys
from station.bus.address import BusAddress
from tests.faults.bus_station import frozen
from tests.faults.rivals import (
    HOST,
    changes,
    commander,
    expect_no_kick,
    refuse_a_stranger,
    refuse_ours,
    refuse_the_second,
    told_by_robot,
    writes_of,
)
from tests.servers.g1_station import LEAVING, PATIENT, ROBOT, G1Process, StockCommander, logged
from tests.waiting import wait_until


def test_the_second_of_two_motion_servers_is_refused_and_takes_over_when_the_first_is_killed(
    bus_server: BusAddress,
) -> None:
    lost, _ = refuse_the_second(bus_server, *LEAVING)
    assert lost == []


def test_a_robots_server_that_stood_still_itself_goes_on_obeying_the_first(bus_server: BusAddress) -> None:
    with (
        logged(bus_server) as log,
        G1Process(bus_server, *LEAVING) as robot,
        commander(bus_server, "first", "builtin:stand") as first,
    ):
        wait_until(lambda: log.gate()["state"] == "tracking")
        with commander(bus_server, "second", "builtin:wave"):
            wait_until(lambda: told_by_robot(log))
            written = len(writes_of(log, "first"))
            with frozen(robot.process.pid):
                wait_until(lambda: len(writes_of(log, "first")) > written + 300)  # longer than it may be silent
                first.send_signal(signal.SIGSTOP)
                count = len(writes_of(log, "second"))
                wait_until(lambda: len(writes_of(log, "second")) > count)  # the newest write that the robot finds
            ticks = len(log.states())
            wait_until(lambda: len(log.states()) > ticks + 2)
            first.send_signal(signal.SIGCONT)
            wait_until(lambda: changes(log)[-1:] == [("entering", "tracking")] and len(log.states()) > ticks + 50)
            assert not log.events("command-handover")


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


def test_whoever_begins_last_is_obeyed_where_that_is_configured(bus_server: BusAddress) -> None:
    with (
        logged(bus_server) as log,
        G1Process(bus_server, *PATIENT, "gate.rivals=newest"),
        commander(bus_server, "first", "builtin:stand"),
    ):
        wait_until(lambda: log.gate()["state"] == "tracking")
        with commander(bus_server, "second", "builtin:wave") as second:
            wait_until(lambda: log.events("command-handover"))
            wait_until(lambda: log.events("second-writer"))
            wait_until(lambda: log.gate()["refused"] > 50)
            (handover,) = log.events("command-handover")
            assert handover.detail["obeyed"] == f"second (pid {second.pid} on {HOST})"
            assert handover.detail["reason"] == "it began to write last"
    assert ("tracking", "entering") in changes(log)
    expect_no_kick(log)


def test_a_stock_script_in_place_of_our_motion_server_is_followed_and_no_rival(bus_server: BusAddress) -> None:
    with logged(bus_server) as log, G1Process(bus_server, *LEAVING):
        with commander(bus_server, "ours", "builtin:stand") as ours:
            wait_until(lambda: log.gate()["state"] == "tracking")
            ours.send_signal(signal.SIGTERM)
            assert ours.wait(30) == 0
        with StockCommander(bus_server):
            wait_until(lambda: log.events("command-handover"))
            wait_until(lambda: log.gate()["state"] == "tracking")
        (handover,) = log.events("command-handover")
        assert handover.detail["obeyed"] == "a foreign writer"
    assert not log.events("second-writer")
