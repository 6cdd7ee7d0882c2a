"""No stop escapes a robot, whatever is written after it or happens to the bus; and a release starts no motion.

`tests/servers/test_g1_stops.py` and `tests/faults/test_bus.py` do the like with real processes.
"""

from __future__ import annotations

import pytest

from station.bus import keys
from station.bus.client import Bus
from station.bus.connection import Connection
from tests.control.test_stop_trace import HIDDEN
from tests.virtual.clock import VirtualClock
from tests.virtual.network import Network
from tests.virtual.station import ControlledRobot, Walk, commander, events, states

WALK = Walk(0.5, 0.1)


@pytest.mark.parametrize("how", HIDDEN)
def test_a_stop_is_obeyed_though_it_is_overwritten_or_deleted_in_the_same_breath(
    clock: VirtualClock, network: Network, robot: ControlledRobot, line: Connection, how: str
) -> None:
    line.pipeline(HIDDEN[how])
    clock.until(lambda: robot.state == "stopped")
    seen = len(robot.ticks)
    clock.sleep(0.5)
    assert set(states(robot, seen)) == {"stopped"}
    line.call("SET", keys.ESTOP, b"0")
    clock.until(lambda: robot.state == "waiting")
    clock.until(lambda: events(network, "operator-reset"))
    assert len(events(network, "estop")) == 1


def test_a_release_in_the_middle_of_a_running_command_starts_no_motion(
    clock: VirtualClock, network: Network, robot: ControlledRobot, line: Connection
) -> None:
    first = commander(network, "stock", "stock", WALK)
    clock.until(lambda: robot.state == "tracking")
    line.call("SET", keys.ESTOP, b"1")
    clock.until(lambda: robot.state == "stopped")
    line.call("SET", keys.ESTOP, b"0")
    clock.until(lambda: robot.state == "waiting")
    seen = len(robot.ticks)
    clock.sleep(5.0)
    assert set(states(robot, seen)) == {"waiting"}
    assert robot.newest.decision.reason == "there was a stop; let go, then engage anew"
    clock.kill(first.process)
    clock.sleep(0.5)
    commander(network, "again", "stock", WALK)
    clock.until(lambda: robot.state == "tracking")


@pytest.mark.parametrize("stop", [b"1", b'{"stop": true, "who": "anna", "reason": "smoke"}', b"nonsense"])
def test_the_emergency_stop_damps_and_is_left_only_by_a_reset(
    clock: VirtualClock, network: Network, robot: ControlledRobot, bus: Bus, stop: bytes
) -> None:
    commander(network, "teleop", "teleop", WALK)
    clock.until(lambda: robot.state == "tracking")
    bus.publish({keys.ESTOP: stop})
    clock.sleep(0.06)
    seen = len(robot.ticks)
    clock.sleep(5.0)
    assert set(states(robot, seen)) == {"stopped"}
    assert not any(tick.record.sent.kp.any() for tick in robot.ticks[seen:]), "damped: no stiffness"
    assert all(tick.record.sent.kd.all() for tick in robot.ticks[seen:])
    bus.publish({keys.ESTOP: b"0"})
    clock.until(lambda: robot.state == "waiting")


def test_a_stop_that_stood_before_the_server_started_holds(clock: VirtualClock, network: Network, bus: Bus) -> None:
    bus.publish({keys.ESTOP: b"1"})
    robot = ControlledRobot(network)
    clock.sleep(1.0)
    assert set(states(robot)) == {"stopped"}


def test_a_stop_that_was_pressed_while_the_robot_could_not_hear_is_obeyed_and_a_reset_is_not(
    clock: VirtualClock, network: Network, robot: ControlledRobot, bus: Bus
) -> None:
    commander(network, "stock", "stock", WALK)
    clock.until(lambda: robot.state == "tracking")
    for request, then in ((b'{"stop": true}', "stopped"), (b'{"stop": false}', "stopped")):
        told = len(events(network, "bus-back"))
        network.link(robot.process).is_refused = True
        network.cut(robot.process)
        clock.sleep(0.1)
        bus.publish({keys.ESTOP: request})
        clock.sleep(0.1)
        network.link(robot.process).is_refused = False
        clock.until(lambda told=told: len(events(network, "bus-back")) > told)
        seen = len(robot.ticks)
        clock.sleep(0.5)
        assert set(states(robot, seen)) == {then}
    bus.publish({keys.ESTOP: b'{"stop": false}'})
    clock.until(lambda: robot.state == "waiting")


def test_a_stop_is_obeyed_though_somebody_has_switched_off_what_tells_the_robot_of_it(
    clock: VirtualClock, network: Network, robot: ControlledRobot, bus: Bus
) -> None:
    """The usual idiom of who wants to hear of expired keys alone, right before the stop; nothing is written again."""
    commander(network, "stock", "stock", WALK)
    clock.until(lambda: robot.state == "tracking")
    bus.call("CONFIG", "SET", "notify-keyspace-events", "Ex")
    bus.call("SET", keys.ESTOP, b'{"stop": true}')
    clock.until(lambda: robot.state == "stopped", 0.2)
    clock.until(lambda: events(network, "watch-back"))
    assert "some client set notify-keyspace-events to 'xE'" in events(network, "watch-back")[0].detail["reason"]
    bus.publish({keys.ESTOP: b'{"stop": false}'})
    clock.until(lambda: robot.state == "waiting")


def test_a_restarted_bus_that_has_forgotten_a_stop_is_told_again(
    clock: VirtualClock, network: Network, robot: ControlledRobot, bus: Bus
) -> None:
    bus.publish({keys.ESTOP: b"1"})
    clock.until(lambda: robot.state == "stopped")
    seen = len(robot.ticks)
    for _ in range(3):
        network.restart_server(0.3)
        clock.sleep(2.0)
        assert keys.ESTOP.encode() in network.server.keys(0)
    assert set(states(robot, seen)) == {"stopped"}
    assert len(events(network, "estop-restated")) == 3


def test_a_release_from_before_a_stop_past_the_bus_does_not_release_it(
    clock: VirtualClock, network: Network, robot: ControlledRobot, line: Connection
) -> None:
    seen = len(robot.ticks)
    clock.until(lambda: len(robot.ticks) > seen)  # both come between two ticks
    line.call("SET", keys.ESTOP, b"0")
    clock.sleep(0.002)
    robot.stop_past_the_bus()
    clock.until(lambda: robot.state == "stopped", 0.05)
    seen = len(robot.ticks)
    clock.sleep(0.5)
    assert set(states(robot, seen)) == {"stopped"}
    assert len(events(network, "release-refused")) == 1


def test_a_stop_past_the_bus_is_obeyed_though_the_bus_is_gone(
    clock: VirtualClock, network: Network, robot: ControlledRobot
) -> None:
    network.restart_server(1e6)
    clock.sleep(1.0)
    robot.stop_past_the_bus()
    clock.until(lambda: robot.state == "stopped", 0.05)
