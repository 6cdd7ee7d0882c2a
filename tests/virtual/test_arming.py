"""When a robot that starts disarmed may be armed, what it is sent until then, and what is told to who asked.

`tests/servers/test_arming.py` has the simulated G1 in its real server.
"""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
import pytest

from station.bus import codec, keys
from station.bus.client import Bus
from station.errors import NotReady, Refused
from station.life import arm_request
from station.life.arm_request import ArmRequest
from station.life.request import OVERTAKEN
from tests.virtual.clock import VirtualClock
from tests.virtual.network import Network
from tests.virtual.station import FORMAT, Commander, ControlledRobot, Walk, commander, events

STOP = b'{"stop": true, "who": "ada", "reason": "smoke"}'


@pytest.fixture
def walker(network: Network) -> Commander:
    return commander(network, "stock", "stock", Walk(0.5, 0.1))


def writes(clock: VirtualClock, network: Network, value: bytes) -> Callable[[], None]:
    """Have a script write a value of the command fifty times a second; return what ends it."""
    ended = []

    def run() -> None:
        with Bus(network.address(), name="script") as bus:
            while not ended:
                bus.publish({FORMAT.key: value})
                clock.sleep(0.02)

    clock.spawn(run, "script")
    return lambda: ended.append(True)


def stiffness(robot: ControlledRobot) -> list[float]:
    return [float(tick.record.sent.kp[0]) for tick in robot.ticks]


def is_refused(robot: ControlledRobot, times: int) -> bool:
    return bool(robot.ticks) and robot.refused > times


def test_a_disarmed_robot_gets_nothing_though_its_policy_follows_the_commands(
    clock: VirtualClock, disarmed: ControlledRobot, walker: Commander
) -> None:
    clock.until(lambda: disarmed.state == "tracking")
    assert {tick.arming for tick in disarmed.ticks} == {"disarmed"}
    assert not any(tick.record.sent.kp.any() or tick.record.sent.kd.any() for tick in disarmed.ticks)
    assert np.abs(disarmed.newest.action).max() > 0.1


def test_arming_ramps_the_stiffness_up_over_two_seconds_and_is_told(
    clock: VirtualClock, network: Network, bus: Bus, disarmed: ControlledRobot
) -> None:
    assert arm_request.ask(bus, "arm") == {"g1": ["arming", "armed"]}
    clock.until(lambda: events(network, "armed"))
    rising = [share for share in stiffness(disarmed) if 0.0 < share < 50.0]
    assert len(rising) == pytest.approx(99, abs=2), "two seconds of 50 ticks"
    np.testing.assert_allclose(np.diff(rising), 0.5, atol=0.02)
    (told,) = events(network, "arming")
    assert told.detail["ramp_s"] == 2.0
    assert arm_request.ask(bus, "disarm") == {"g1": ["disarmed"]}
    assert stiffness(disarmed)[-1] == 0.0


def test_a_request_to_arm_that_is_written_again_after_the_robot_was_disarmed_arms_nothing(
    clock: VirtualClock, network: Network, bus: Bus, disarmed: ControlledRobot
) -> None:
    written = codec.json_object(ArmRequest(action="arm", id="once"))
    bus.publish({keys.ARM: written})
    clock.until(lambda: disarmed.ticks[-1].arming == "armed")
    arm_request.ask(bus, "disarm")
    ticks = len(disarmed.ticks)
    bus.publish({keys.ARM: written})
    clock.until(lambda: len(disarmed.ticks) > ticks + 50)
    assert {tick.arming for tick in disarmed.ticks[ticks + 1 :]} == {"disarmed"}
    assert len(events(network, "arming")) == 1


def test_a_request_to_arm_that_comes_after_a_later_one_to_disarm_arms_nothing_and_is_told(
    clock: VirtualClock, network: Network, bus: Bus, disarmed: ControlledRobot
) -> None:
    arm_request.ask(bus, "disarm")
    bus.publish({keys.ARM: codec.json_object(ArmRequest(action="arm", id="lost", late_s=1.0))})
    clock.until(lambda: events(network, "arm-refused"))
    assert events(network, "arm-refused")[0].detail["reason"] == OVERTAKEN
    assert {tick.arming for tick in disarmed.ticks} == {"disarmed"}
    assert arm_request.ask(bus, "arm") == {"g1": ["arming", "armed"]}
    bus.publish({keys.ARM: codec.json_object(ArmRequest(action="disarm", id="late", late_s=60.0))})
    clock.until(lambda: disarmed.ticks[-1].arming == "disarmed")


def test_what_is_no_request_to_arm_is_told(
    clock: VirtualClock, network: Network, bus: Bus, disarmed: ControlledRobot
) -> None:
    bus.publish({keys.ARM: b'{"action": "lift"}'})
    clock.until(lambda: events(network, "request-refused"))
    (told,) = events(network, "request-refused")
    assert told.detail["reason"].startswith("not an arm request: ")


def test_arming_is_refused_while_commands_come_that_are_not_valid(
    clock: VirtualClock, network: Network, bus: Bus, disarmed: ControlledRobot
) -> None:
    bad = FORMAT.default.copy()
    bad[7] = 9.0
    writes(clock, network, codec.json_vector(bad))
    clock.until(lambda: is_refused(disarmed, 5))
    with pytest.raises(Refused, match=r"g1 is not armed: commands come and are refused .out-of-range: left_"):
        arm_request.ask(bus, "arm")
    clock.until(lambda: events(network, "arm-refused"))
    assert not np.any(stiffness(disarmed))


def test_arming_is_refused_while_the_command_is_stale_and_allowed_once_the_robot_is_asked_to_stand(
    clock: VirtualClock, bus: Bus, disarmed: ControlledRobot, walker: Commander
) -> None:
    clock.until(lambda: disarmed.state == "tracking")
    clock.kill(walker.process)
    for state in ("holding", "returning"):
        clock.until(lambda state=state: disarmed.state == state)
        with pytest.raises(Refused, match=r"the command is stale .the newest good command is"):
            arm_request.ask(bus, "arm")
    clock.until(lambda: disarmed.state == "waiting")
    assert arm_request.ask(bus, "arm") == {"g1": ["arming", "armed"]}


def test_after_an_emergency_stop_it_takes_a_reset_and_then_arming(
    clock: VirtualClock, bus: Bus, disarmed: ControlledRobot
) -> None:
    arm_request.ask(bus, "arm")
    bus.publish({keys.ESTOP: STOP})
    clock.until(lambda: disarmed.state == "stopped")
    with pytest.raises(Refused, match=r"the emergency stop is latched .ada, smoke.; release it first"):
        arm_request.ask(bus, "arm")
    assert disarmed.state == "stopped", "to arm is not to release"
    bus.publish({keys.ESTOP: b"0"})
    clock.until(lambda: disarmed.state == "waiting")
    assert disarmed.ticks[-1].arming == "disarmed"
    assert arm_request.ask(bus, "arm") == {"g1": ["arming", "armed"]}


def test_who_waits_for_a_robot_that_is_stopped_while_it_is_arming_is_told_so(
    clock: VirtualClock, network: Network, bus: Bus, disarmed: ControlledRobot
) -> None:
    def stop() -> None:
        clock.until(lambda: events(network, "arming"))
        with Bus(network.address(), name="button") as button:
            button.publish({keys.ESTOP: b"1"})

    clock.spawn(stop, "button")
    with pytest.raises(Refused, match="g1 was stopped while it was arming"):
        arm_request.ask(bus, "arm")
    assert disarmed.state == "stopped"
    assert not stiffness(disarmed)[-1]


def test_the_key_of_the_emergency_stop_arms_under_the_same_rules(
    clock: VirtualClock, network: Network, bus: Bus, disarmed: ControlledRobot
) -> None:
    release = b'{"stop": false, "arm": true, "who": "ada"}'
    end = writes(clock, network, codec.json_vector(np.zeros(3)))
    clock.until(lambda: is_refused(disarmed, 5))
    bus.publish({keys.ESTOP: release})
    clock.until(lambda: events(network, "arm-refused"))
    end()
    clock.sleep(2.0)
    assert {tick.arming for tick in disarmed.ticks} == {"disarmed"}
    bus.publish({keys.ESTOP: release})
    clock.until(lambda: disarmed.ticks[-1].arming == "armed")


def test_a_request_from_before_the_server_started_arms_nothing_and_garbage_neither(
    clock: VirtualClock, network: Network, bus: Bus
) -> None:
    bus.publish({keys.ARM: json.dumps({"action": "arm", "id": "1"}).encode()})
    robot = ControlledRobot(network, is_simulated=False)
    clock.until(lambda: len(robot.ticks) > 20)
    for garbage in (b"", b"arm", b'{"action": "fire"}', b'{"action": "arm", "server": "other"}', b"[" * 9999):
        bus.publish({keys.ARM: garbage})
        clock.sleep(0.1)
    assert {tick.arming for tick in robot.ticks} == {"disarmed"}


def test_who_is_not_there_cannot_be_armed(bus: Bus) -> None:
    with pytest.raises(NotReady, match=r"no low-level server runs on .*; start a station first"):
        arm_request.ask(bus, "arm")
