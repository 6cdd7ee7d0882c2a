"""A robot that starts disarmed, in its real server: what it is sent, when it may be armed, and what is told."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.errors import NotReady, Refused
from station.life import arm_request
from tests.servers.g1_station import FORM, LIGHT, ROBOT, G1Process, StockCommander, logged, publish, ticks
from tests.servers.g1_trials import arm, stiffness
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


def test_arming_is_refused_while_commands_come_that_are_not_valid(bus_server: BusAddress) -> None:
    bad = FORM.default.copy()
    bad[7] = 9.0
    with logged(bus_server) as log, G1Process(bus_server, *DISARMED), Bus(bus_server, name="ada", timeout_s=5.0) as bus:
        with StockCommander(bus_server, lambda _: bad):
            wait_until(lambda: log.gate()["refused"] > 5)
            with pytest.raises(Refused, match=r"g1 is not armed: commands come and are refused .out-of-range: left_"):
                arm_request.ask(bus, "arm")
        wait_until(lambda: log.events("arm-refused"))
        assert log.gate()["arming"] == "disarmed"
        assert not np.any(stiffness(log))


def test_arming_is_refused_while_the_command_is_stale_and_allowed_once_the_robot_is_asked_to_stand(
    bus_server: BusAddress,
) -> None:
    with logged(bus_server) as log, G1Process(bus_server, *DISARMED), Bus(bus_server, name="ada", timeout_s=5.0) as bus:
        with StockCommander(bus_server):
            wait_until(lambda: log.gate()["state"] == "tracking")
        wait_until(lambda: log.gate()["state"] in ("holding", "returning"))
        with pytest.raises(Refused, match=r"the command is stale .the newest good command is"):
            arm_request.ask(bus, "arm")
        wait_until(lambda: log.gate()["state"] == "waiting")
        assert arm_request.ask(bus, "arm") == {"g1": ["arming", "armed"]}


def test_after_an_emergency_stop_it_takes_a_reset_and_then_arming(bus_server: BusAddress) -> None:
    with logged(bus_server) as log, G1Process(bus_server, *DISARMED), Bus(bus_server, name="ada", timeout_s=5.0) as bus:
        wait_until(lambda: ticks(log) > 5)
        arm_request.ask(bus, "arm")
        bus.publish({keys.ESTOP: b'{"stop": true, "who": "ada", "reason": "smoke"}'})
        wait_until(lambda: log.gate()["state"] == "stopped")
        with pytest.raises(Refused, match=r"the emergency stop is latched .ada, smoke.; release it first"):
            arm_request.ask(bus, "arm")
        assert log.gate()["state"] == "stopped", "to arm is not to release"
        bus.publish({keys.ESTOP: b"0"})
        wait_until(lambda: log.gate()["state"] == "waiting")
        assert log.gate()["arming"] == "disarmed"
        assert arm_request.ask(bus, "arm") == {"g1": ["arming", "armed"]}


def test_who_waits_for_a_robot_that_is_stopped_while_it_is_arming_is_told_so(bus_server: BusAddress) -> None:
    with logged(bus_server) as log, G1Process(bus_server, *DISARMED), Bus(bus_server, name="ada", timeout_s=5.0) as bus:
        wait_until(lambda: ticks(log) > 5)
        with ThreadPoolExecutor(1) as pool:
            asked = pool.submit(arm_request.ask, bus, "arm")
            wait_until(lambda: log.events("arming"))
            with Bus(bus_server, name="button", timeout_s=5.0) as button:
                button.publish({keys.ESTOP: b"1"})
            with pytest.raises(Refused, match="g1 was stopped while it was arming"):
                asked.result(30)
        wait_until(lambda: log.gate()["state"] == "stopped")  # the log may be behind the answer
        assert not stiffness(log)[-1]


def test_the_key_of_the_emergency_stop_arms_under_the_same_rules(bus_server: BusAddress) -> None:
    release = b'{"stop": false, "arm": true, "who": "ada"}'
    with logged(bus_server) as log, G1Process(bus_server, *DISARMED), Bus(bus_server, name="ada", timeout_s=5.0) as bus:
        with StockCommander(bus_server, lambda _: np.zeros(3)):
            wait_until(lambda: log.gate()["refused"] > 5)
            bus.publish({keys.ESTOP: release})
            wait_until(lambda: log.events("arm-refused"))
        silent_since = ticks(log)
        wait_until(lambda: ticks(log) > silent_since + 5)
        refused = log.gate()["refused"]
        wait_until(lambda: ticks(log) > silent_since + 100)
        assert (log.gate()["refused"], log.gate()["arming"]) == (refused, "disarmed")
        bus.publish({keys.ESTOP: release})
        wait_until(lambda: log.gate()["arming"] == "armed")


def test_a_request_from_before_the_server_started_arms_nothing(bus_server: BusAddress) -> None:
    with logged(bus_server) as log, Bus(bus_server, name="ghost", timeout_s=5.0) as bus:
        bus.publish({keys.ARM: json.dumps({"action": "arm", "id": "1"}).encode()})
        with G1Process(bus_server, *DISARMED):
            wait_until(lambda: ticks(log) > 20)
            assert log.gate()["arming"] == "disarmed"
            for garbage in (b"", b"arm", b'{"action": "fire"}', b'{"action": "arm", "server": "other"}', b"[" * 9999):
                bus.publish({keys.ARM: garbage})
            before = ticks(log)
            wait_until(lambda: ticks(log) > before + 20)
            assert log.gate()["arming"] == "disarmed"


def test_who_is_not_there_cannot_be_armed(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="ada", timeout_s=5.0) as bus:
        publish(bus, FORM.default)
        with pytest.raises(NotReady, match=r"no low-level server runs on .*; start a station first"):
            arm_request.ask(bus, "arm")
