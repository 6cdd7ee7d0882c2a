"""What the robot's side allows, on a real bus: the test plays the robot's server."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.operator.robot_side import FOLLOWS_WITHIN_S, SILENT_S, RobotSide
from tests.waiting import wait_until

ROBOT, SIZE = "r", 3
SECOND = 1_000_000_000


class Side:
    """A robot's server that says what it is told to, and who looks at it."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.watch = bus.watch(RobotSide.watched(ROBOT))
        wait_until(lambda: self.watch.is_connected)
        self.robot = RobotSide(self.watch, ROBOT, SIZE)

    def say(self, state: str, **more: Any) -> None:
        """Say the gate's state, and see that it was heard."""
        key, before = keys.command_gate(ROBOT), self.watch.latest(keys.command_gate(ROBOT))
        self.bus.publish({key: codec.json_object({"state": state, "reason": "so", **more})})
        wait_until(lambda: self.watch.latest(key) is not before)

    def stop(self, stop: bool) -> None:
        before = self.watch.latest(keys.ESTOP)
        self.bus.publish({keys.ESTOP: codec.json_object({"stop": stop})})
        wait_until(lambda: self.watch.latest(keys.ESTOP) is not before)

    def look(self, later_s: float = 0.0) -> RobotSide:
        """Look so much later than the gate spoke, however long the machine took to come here."""
        sample = self.watch.latest(keys.command_gate(ROBOT))
        now_ns = sample.arrived_ns if sample is not None else None
        self.robot.poll((now_ns or time.monotonic_ns()) + int(later_s * SECOND))
        return self.robot


@pytest.fixture
def side(bus_server: BusAddress) -> Iterator[Side]:
    with Bus(bus_server, name="tests", timeout_s=5.0) as bus:
        made = Side(bus)
        yield made
        made.watch.close()


def test_robot_without_a_gate_allows_everything(side: Side) -> None:
    assert (side.look().why_blocked, side.robot.left, side.robot.used) == ("", "", None)


def test_latched_stop_is_an_obstacle_until_it_is_released(side: Side) -> None:
    side.stop(True)
    assert side.look().why_blocked == "the emergency stop is latched"
    side.stop(False)
    assert side.look().why_blocked == ""


@pytest.mark.parametrize(
    ("state", "more", "why_blocked"),
    [
        ("stopped", {}, "the emergency stop is latched"),
        ("waiting", {"arming": "disarmed"}, "the robot is disarmed"),
        ("returning", {}, "the robot is on its way to standing; wait for it"),
        ("waiting", {"needs_silence": "there was a stop; let go"}, "there was a stop; let go"),
        ("waiting", {"arming": "armed"}, ""),
    ],
)
def test_state_of_the_gate_may_be_an_obstacle(side: Side, state: str, more: dict[str, Any], why_blocked: str) -> None:
    side.say(state, **more)
    assert side.look().why_blocked == why_blocked


def test_server_that_fell_silent_is_an_obstacle(side: Side) -> None:
    side.say("waiting")
    assert side.look(later_s=SILENT_S + 0.1).why_blocked == "the robot's server is silent"


def test_robot_that_followed_and_does_so_no_more_has_left(side: Side) -> None:
    side.say("waiting")
    side.robot.begin(time.monotonic_ns())
    assert side.look().left == ""  # what it said before our first command
    side.say("tracking")
    assert side.look().left == ""
    side.say("holding")
    assert side.look().left == ""
    side.say("returning")
    assert side.look().left == "the robot follows no more (returning: so)"
    assert side.robot.why_blocked == side.robot.left
    side.robot.end()
    assert side.look().left == ""


def test_robot_that_obeys_somebody_else_is_left_alone(side: Side) -> None:
    side.say("waiting")
    said = side.watch.latest(keys.command_gate(ROBOT))
    assert said is not None
    assert said.arrived_ns is not None
    side.robot.begin(said.arrived_ns - 1)  # just before, however long this machine took for it
    assert side.look().left == ""
    assert side.look(later_s=FOLLOWS_WITHIN_S + 0.1).left.startswith("the robot does not follow (waiting")


def test_command_that_the_robot_follows_is_known_when_it_is_one(side: Side) -> None:
    key = keys.command_used(ROBOT)
    for value, known in ((codec.f64(np.arange(3.0)), True), (codec.f64(np.zeros(2)), False), (b"odd", False)):
        before = side.watch.latest(key)
        side.bus.publish({key: value})
        wait_until(lambda before=before: side.watch.latest(key) is not before)  # type: ignore[misc]
        assert (side.look().used is not None) == known


def test_a_fault_of_the_robot_s_controller_is_an_obstacle_and_ends_following(side: Side) -> None:
    side.say("tracking")
    side.robot.begin(time.monotonic_ns() - SECOND)
    side.say("tracking")
    assert side.look().left == ""
    side.say("faulted")
    assert side.look().left == "the robot follows no more (faulted: so)"
    side.robot.end()
    assert side.look().why_blocked == "the robot's controller has a fault: so"


def test_a_robot_that_stays_where_it_is_has_to_say_first_where_that_is(side: Side) -> None:
    side.robot = RobotSide(side.watch, ROBOT, SIZE, holds_position=True)
    assert side.look().why_blocked == "the robot has not said where it is; is its server started?"
    side.bus.publish({keys.command_used(ROBOT): codec.f64(np.ones(SIZE))})
    wait_until(lambda: side.look().used is not None)
    assert side.look().why_blocked == ""
