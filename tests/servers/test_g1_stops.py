"""A motion ends with the stop of its robot. What a stop does to the robot is in `tests/virtual/test_stops.py`."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.connection import Connection
from tests.servers.g1_station import ROBOT, logged, motion_process
from tests.waiting import DEADLINE_S, wait_until


@pytest.fixture
def line(bus_server: BusAddress) -> Iterator[Connection]:
    connection = Connection(bus_server, timeout_s=5.0)
    yield connection
    connection.close()


@contextmanager
def waving(address: BusAddress, *settings: str) -> Iterator[subprocess.Popen[str]]:
    """A motion that never ends by itself; killed at the end."""
    with motion_process(address, "motion=builtin:wave", "loop=true", *settings) as motion:
        try:
            yield motion
        finally:
            motion.kill()


@pytest.mark.parametrize("settings", [(), ("pace=state", "patience_s=0.2")], ids=["by the clock", "in lock-step"])
def test_a_motion_ends_with_a_stop_and_says_how_to_go_on(
    bus_server: BusAddress, line: Connection, settings: tuple[str, ...]
) -> None:
    with logged(bus_server) as log:
        with waving(bus_server, *settings) as motion:
            wait_until(lambda: log.of(twist_keys.action_body()))
            line.call("SET", keys.ESTOP, b'{"stop": true, "who": "anna", "reason": "smoke"}')
            _, err = motion.communicate(timeout=DEADLINE_S)
        line.call("SET", "the_motion", b"has ended")
        log.last("the_motion")
        sources = [codec.parse_json(value) for value in log.values(keys.command_source(ROBOT))]
        assert not {"leaving", "done"} & {source["phase"] for source in sources}, "no blend"
    assert motion.returncode == 1
    assert "the emergency stop (anna, smoke) ended the motion at " in err
    assert "release it (`station estop --reset`), then start the motion again" in err


def test_a_motion_ends_with_the_stop_of_its_robot_though_the_key_says_otherwise(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="g1", timeout_s=5.0) as robot, logged(bus_server) as log:
        gate = keys.command_gate(ROBOT)
        with waving(bus_server) as motion:
            wait_until(lambda: log.of(twist_keys.action_body()))

            def ends() -> bool:
                """Follow it and be stopped, and so again where it looked too late to see that it was followed."""
                for state in ("tracking", "stopped"):
                    seen = len(log.of(twist_keys.action_body()))
                    robot.publish({gate: codec.json_object({"state": state, "reason": "smoke"})})
                    wait_until(
                        lambda seen=seen: len(log.of(twist_keys.action_body())) > seen + 5 or motion.poll() is not None
                    )  # type: ignore[misc]
                return motion.poll() is not None

            wait_until(ends)
            _, err = motion.communicate(timeout=DEADLINE_S)
    assert "the emergency stop (smoke) ended the motion" in err
