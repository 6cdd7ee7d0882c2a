"""A G1 across a cable (R10): discovered by multicast, driven, and damped by its guard when the cable is pulled."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from station import Station
from station.errors import Refused
from tests.bridges.g1_guard import wire_log
from tests.bridges.g1_guard.deployment import ATTEMPTS, FASTEST_RAD_S, ROBOT_ADDRESS, Deployment, deployment
from tests.waiting import wait_until

pytestmark = pytest.mark.timeout(300)

WATCHED_S = 6.0


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

    def is_refused_for_it() -> bool:
        with pytest.raises(Refused) as refused:  # a busy machine, too, is a reason, and may be the first one
            station.arm()
        return "% are lost on the way" in str(refused.value)

    with Station(good.operator_home.bus.url) as station:
        wait_until(is_refused_for_it)
    good.wait_for_the_doctor("are lost on the way")
