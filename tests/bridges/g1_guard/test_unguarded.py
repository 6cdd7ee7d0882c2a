"""A G1 without a guard on its own computer (R11): what a pulled cable leaves of it.

In a file of its own: a robot that is driven meanwhile, as in `test_deployment.py`, takes the processor of its twin.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from tests.bridges.g1_guard import wire_log
from tests.bridges.g1_guard.deployment import ATTEMPTS, FASTEST_RAD_S, Deployment, deployment
from tests.waiting import wait_until

pytestmark = pytest.mark.timeout(300)


@pytest.fixture
def bare(compiler: str, network_links: None, real_time: None, tmp_path: Path) -> Iterator[Deployment]:
    """A robot whose firmware holds the last command for ever, and nothing on its computer that would damp it."""
    with deployment(tmp_path) as found:
        found.start_twin("faults.without_commands=hold")
        yield found


def test_r11_without_a_guard_a_cable_that_is_pulled_leaves_the_robot_stiff_and_the_doctor_says_so(bare):
    bare.start_server()
    bare.wait_ready()
    bare.wait_for_the_doctor("no guard owns the motors")
    _is_left_stiff(bare)


def test_r11_a_guard_beside_the_station_does_not_help_when_the_cable_is_pulled_and_the_doctor_says_so(bare, plain):
    bare.start_guard(plain, bare.operator, "127.0.0.1")
    bare.start_server("127.0.0.1")
    bare.wait_ready()
    bare.wait_for_the_doctor("not when the robot's cable is cut")
    _is_left_stiff(bare)


def _wait_for_states(found: Deployment, more: int) -> None:
    until = found.twin()["states"]["sent"] + more
    wait_until(lambda: found.twin()["states"]["sent"] > until)


def _is_left_stiff(found: Deployment) -> None:
    """Arm, pull the cable, see that the robot holds what it was told last, and that it is damped once the cable is
    back."""
    for _ in range(ATTEMPTS):
        found.arm()
        armed_ns = time.monotonic_ns()
        pulled_ns = found.link.pull(found.operator)
        wait_until(lambda: found.seen()["arming"] == "disarmed")
        _wait_for_states(found, 1000)  # two seconds of the robot's
        if not found.first_damping_ns(armed_ns):  # else it was given up before: nothing gets through a cable pulled
            break
        found.link.plug()
    else:
        raise AssertionError(f"gave the robot up {ATTEMPTS} times, {found.last_told('robot-fault')}")
    assert found.twin()["is_stiff"], "what a guard on the robot's computer is for"
    found.link.plug()
    wait_until(lambda: found.twin()["is_damped"])
    assert found.wire(wire_log.STATE, pulled_ns)["most_speed"].max() < FASTEST_RAD_S
    found.wait_ready()
    assert found.twin()["is_damped"]
