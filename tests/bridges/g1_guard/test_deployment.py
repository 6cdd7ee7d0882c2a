"""A G1 across a cable (R10, R11): discovered by multicast, driven, and damped by its guard when the cable is pulled."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from station import Station
from station.errors import Refused
from tests.bridges.g1_guard import wire_log
from tests.bridges.g1_guard.deployment import ROBOT_ADDRESS, Deployment, deployment
from tests.waiting import wait_until

pytestmark = pytest.mark.timeout(300)

FASTEST_RAD_S = 3.0
"""Of any joint, from the moment in which the cable is pulled (R10)."""
WATCHED_S = 6.0
ATTEMPTS = 3
"""A busy machine silences a line as well."""


@pytest.fixture(scope="module")
def site(
    plain: Path, network_links: None, real_time: None, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Deployment]:
    """A robot with a guard on its computer, and a server that drives it from the operator's."""
    with deployment(tmp_path_factory.mktemp("site")) as found:
        found.start_twin()
        found.start_guard(plain, found.robot, ROBOT_ADDRESS)
        found.start_server(ROBOT_ADDRESS)
        yield found


@pytest.fixture
def good(site: Deployment) -> Deployment:
    """The site with nothing wrong, not armed."""
    site.link.plug()
    site.link.change()
    if site.twin()["is_stiff"]:
        site.disarm()
    return site


def test_a_robot_is_found_by_multicast_over_the_cable_and_goes_where_it_is_told(good):
    wait_until(lambda: good.has_sunk)
    good.arm()
    wait_until(lambda: good.is_in_its_pose)
    assert good.twin()["refused"] == {}
    assert good.link.counts(good.operator).last_ns > 0, "commands go to the guard, over the cable"


@pytest.mark.parametrize("is_seen", [True, False], ids=["at the plug", "behind a switch"])
def test_r10_a_robot_whose_cable_is_pulled_is_damped_and_nothing_but_arming_moves_it_again(good, is_seen):
    good.arm()
    told = good.times_told("robot-fault reason=no state of the robot")
    pulled_ns = good.link.pull(*([good.operator] if is_seen else []))
    wait_until(lambda: good.twin()["is_damped"])
    wait_until(lambda: good.times_told("robot-fault reason=no state of the robot") > told)
    wait_until(lambda: "no state of the robot for" in good.seen()["why_not_arm"])
    with Station(good.operator_home.bus.url) as station, pytest.raises(Refused, match="no state of the robot"):
        station.arm()
    assert good.seen()["arming"] == "disarmed"
    last_ns = good.link.counts(good.operator).last_ns
    assert last_ns <= pulled_ns
    damping_ns = good.first_damping_ns(last_ns)
    good.link.plug()
    good.wait_ready()
    assert not good.wire(wire_log.COMMAND, damping_ns + 400_000_000)["most_kp"].any(), "the ramp is over"
    assert good.wire(wire_log.STATE, pulled_ns)["most_speed"].max() < FASTEST_RAD_S
    assert good.twin()["is_damped"]
    good.arm()


def test_a_line_that_is_bad_but_not_too_bad_is_driven_over(good):
    for _ in range(ATTEMPTS):
        good.link.change()
        with good.arming():
            good.link.change(delay_s=0.005, jitter_s=0.01, loss=0.01)
            wait_until(lambda: good.seen()["arming"] in {"armed", "disarmed"})
            if good.is_armed_for(WATCHED_S):
                break
    else:
        raise AssertionError(f"gave the robot up {ATTEMPTS} times, {good.last_told('robot-fault')}")
    assert good.is_in_its_pose
    good.disarm()


def test_a_line_that_is_too_bad_is_not_armed_over_and_what_is_lost_is_told(good):
    good.wait_ready()
    good.link.change(loss=0.05, out_of=good.robot)
    wait_until(lambda: "% are lost on the way: is the cable good" in good.seen()["why_not_arm"])
    with Station(good.operator_home.bus.url) as station, pytest.raises(Refused, match="are lost on the way"):
        station.arm()
    _wait_for_the_doctor(good, "are lost on the way")


@pytest.fixture
def bare(compiler: str, network_links: None, real_time: None, tmp_path: Path) -> Iterator[Deployment]:
    """A robot whose firmware holds the last command for ever, and nothing on its computer that would damp it."""
    with deployment(tmp_path) as found:
        found.start_twin("faults.without_commands=hold")
        yield found


def test_r11_without_a_guard_a_cable_that_is_pulled_leaves_the_robot_stiff_and_the_doctor_says_so(bare):
    bare.start_server()
    bare.wait_ready()
    _wait_for_the_doctor(bare, "no guard owns the motors")
    _is_left_stiff(bare)


def test_r11_a_guard_beside_the_station_does_not_help_when_the_cable_is_pulled_and_the_doctor_says_so(bare, plain):
    bare.start_guard(plain, bare.operator, "127.0.0.1")
    bare.start_server("127.0.0.1")
    bare.wait_ready()
    _wait_for_the_doctor(bare, "not when the robot's cable is cut")
    _is_left_stiff(bare)


def _wait_for_the_doctor(found: Deployment, words: str) -> None:
    """Wait until the doctor says something of a server whose heartbeat a busy machine holds back for seconds."""
    wait_until(lambda: words in found.operator_home.run("doctor").stdout)


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
