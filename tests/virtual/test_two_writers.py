"""Two commanders on one key: the robot follows one, and both are told of.

`tests/faults/test_two_writers.py` does the like with real processes.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from station.bus import codec
from station.bus.client import Bus
from station.control.gate import GateConfig
from station.life.events import Event
from tests.examples import some
from tests.virtual.clock import VirtualClock
from tests.virtual.network import Network
from tests.virtual.station import FORMAT, ControlledRobot, Walk, commander, events, states
from tests.virtual.trial import alone

FIRST, SECOND = Walk(0.5, 0.1), Walk(-0.4, 0.3)


def told_by_robot(network: Network) -> list[Event]:
    """What the robot's server says of rivals; a motion server says so of its own key too."""
    return [event for event in events(network, "second-writer") if event.source == "g1"]


def follows(robot: ControlledRobot, walk: Walk) -> bool:
    return robot.state == "tracking" and robot.newest.decision.vector[0] == pytest.approx(walk.speed)


def begin_between(clock: VirtualClock, network: Network, what: str) -> None:
    """Start a second commander that writes half a period after the first: who is overwritten at once is held."""
    written = len(network.server.journal)
    clock.until(lambda: any(key == FORMAT.key.encode() for _, key, _ in network.server.journal[written:]))
    clock.sleep(0.007)
    commander(network, "second", what, SECOND)


@pytest.mark.parametrize(("first", "second"), [("motion", "motion"), ("motion", "teleop"), ("teleop", "motion")])
def test_the_second_is_refused_and_takes_over_with_a_blend_when_the_first_is_killed(
    clock: VirtualClock, network: Network, robot: ControlledRobot, first: str, second: str
) -> None:
    obeyed = commander(network, "first", first, FIRST)
    clock.until(lambda: follows(robot, FIRST))
    begin_between(clock, network, second)
    seen = len(robot.ticks)
    clock.until(lambda: told_by_robot(network))
    clock.sleep(2.0)
    assert set(states(robot, seen)) == {"tracking"}
    assert {tick.vector[0] for tick in robot.ticks[seen:]} == {FIRST.speed}
    assert robot.refused > 80
    told = told_by_robot(network)[0].detail
    assert told["obeyed"].startswith("first (pid ")
    assert told["refused"][0].startswith("second (pid ")
    assert not events(network, "command-handover")
    clock.kill(obeyed.process)
    seen = len(robot.ticks)
    clock.until(lambda: follows(robot, SECOND))
    (handover,) = events(network, "command-handover")
    assert handover.detail["obeyed"].startswith("second (pid ")
    assert handover.detail["reason"].startswith("first (pid ")
    assert handover.detail["reason"].endswith("has been silent")
    followed = states(robot, seen)
    assert followed.count("entering") >= 49, "who takes over is entered with a blend of a second"
    clock.until(lambda: told_by_robot(network)[-1].detail.get("ended"))


def test_a_robots_server_that_stood_still_itself_goes_on_obeying_the_first(
    clock: VirtualClock, network: Network, robot: ControlledRobot
) -> None:
    first = commander(network, "first", "motion", FIRST)
    clock.until(lambda: follows(robot, FIRST))
    begin_between(clock, network, "motion")
    clock.until(lambda: told_by_robot(network))
    clock.freeze(robot.process, 6.0)
    clock.sleep(5.99)
    clock.freeze(first.process, 0.06)  # the newest write that the robot finds is the second's
    clock.sleep(2.0)
    assert follows(robot, FIRST)
    assert not events(network, "command-handover")


def test_whoever_begins_last_is_obeyed_where_that_is_configured(clock: VirtualClock, network: Network) -> None:
    robot = ControlledRobot(network, gate=GateConfig(rivals="newest"))
    commander(network, "first", "teleop", FIRST)
    clock.until(lambda: follows(robot, FIRST))
    commander(network, "second", "teleop", SECOND)
    clock.until(lambda: events(network, "command-handover"))
    clock.until(lambda: follows(robot, SECOND))
    (handover,) = events(network, "command-handover")
    assert handover.detail["obeyed"].startswith("second (pid ")
    assert handover.detail["reason"] == "it began to write last"
    assert events(network, "second-writer")
    assert ("tracking", "entering") in pairwise(states(robot))
    seen = len(robot.ticks)
    clock.sleep(2.0)
    assert {tick.vector[0] for tick in robot.ticks[seen:]} == {SECOND.speed}


@pytest.mark.parametrize("seed", some(range(18)))
def test_nothing_of_a_stock_script_is_taken_for_ours_though_word_of_its_writes_comes_late(seed: int) -> None:
    """What was read comes on one line, word of writes on another, and a network delays each as it likes.

    Where both write within the same moment for a tenth of a second, no value is known to be ours: then the robot holds.
    """
    with alone(), VirtualClock(seed, late_ns=200_000) as clock:
        network = Network(clock, latency_ns=(10_000, 300_000))
        robot = ControlledRobot(network)
        clock.sleep(0.1)
        commander(network, "first", "teleop", FIRST)
        clock.until(lambda: follows(robot, FIRST))
        commander(network, "second", "stock", SECOND)  # its period is longer, so that they meet again and again
        seen = len(robot.ticks)
        clock.sleep(6.0)
        slower = [after for before, after in pairwise(robot.ticks[seen:]) if after.vector[0] < before.vector[0]]
        assert {tick.state for tick in slower} <= {"holding"}
        assert max(tick.vector[0] for tick in robot.ticks[seen:]) == FIRST.speed


@pytest.mark.parametrize("second", ["stock", "elsewhere", "teleop"])
def test_who_follows_another_is_followed_and_no_rival(
    clock: VirtualClock, network: Network, robot: ControlledRobot, second: str
) -> None:
    first = commander(network, "first", "motion", FIRST)
    clock.until(lambda: follows(robot, FIRST))
    first.leave()
    clock.until(lambda: not clock.is_running(first.process))
    commander(network, "second", second, SECOND)
    clock.until(lambda: follows(robot, SECOND))
    assert len(events(network, "command-handover")) == 1
    assert not events(network, "second-writer")


def test_on_a_bus_that_is_polled_the_second_takes_over_when_the_first_is_killed(
    clock: VirtualClock, network: Network
) -> None:
    network.server.refused.add(b"CONFIG")
    robot = ControlledRobot(network)
    first = commander(network, "first", "teleop", FIRST)
    clock.until(lambda: follows(robot, FIRST))
    commander(network, "second", "teleop", SECOND)
    clock.until(lambda: told_by_robot(network))
    clock.kill(first.process)
    clock.until(lambda: follows(robot, SECOND), 3.0)


def test_commands_that_a_frozen_line_kept_move_nothing_when_it_goes_on(
    clock: VirtualClock, network: Network, robot: ControlledRobot
) -> None:
    """Their writer is dead by then, so that none among them is fresh."""
    first = commander(network, "first", "teleop", FIRST)
    clock.until(lambda: follows(robot, FIRST))
    network.freeze(first.process, 4.0)
    clock.sleep(0.5)
    clock.kill(first.process)
    clock.until(lambda: robot.state == "waiting")
    seen = len(robot.ticks)
    clock.until(lambda: events(network, "refused-command"))
    clock.sleep(0.5)
    assert set(states(robot, seen)) == {"waiting"}
    assert all(np.array_equal(tick.vector, FORMAT.default) for tick in robot.ticks[seen:])
    assert events(network, "refused-command")[0].detail["reason"].startswith("stale: written ")
    commander(network, "second", "teleop", SECOND)
    clock.until(lambda: follows(robot, SECOND))
    assert events(network, "command-good-again")


def test_a_command_left_over_from_another_time_moves_nothing(clock: VirtualClock, network: Network, bus: Bus) -> None:
    bus.publish({FORMAT.key: codec.json_vector(FIRST.vector(0.0))})
    robot = ControlledRobot(network)
    clock.sleep(1.0)
    assert set(states(robot)) == {"waiting"}
