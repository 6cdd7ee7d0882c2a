"""What the session tells of a controller, and that nobody drives on when it takes no more targets by itself."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from adapters.robots.kassow.session import beyond_reach
from tests.adapters.robots.kassow.driven_arm import LIMITS, DrivenArm


@pytest.fixture
def driven(kord: Any) -> Iterator[DrivenArm]:
    made = DrivenArm(kord)
    yield made
    made.session.close()


def test_it_tells_whether_targets_are_taken(driven: DrivenArm) -> None:
    assert not driven.session.read().is_engaged
    driven.drive(20)
    assert driven.session.read().is_engaged
    driven.session.release()
    assert not driven.session.read().is_engaged


def test_after_the_bridge_disengaged_by_itself_who_never_lets_go_is_not_followed(driven: DrivenArm) -> None:
    driven.drive(20)
    driven.bridge.disengage()
    record = driven.drive(1)
    assert "engagement-lost" in [step_event.name for step_event in record.step_events]
    sends = driven.bridge.get_state().stream_j_sends
    record = driven.drive(300)
    assert record.decision.state == "waiting"
    assert driven.bridge.get_state().stream_j_sends == sends


def test_a_target_is_as_far_ahead_as_the_profile_that_is_at_work_allows(driven: DrivenArm) -> None:
    by_speed_rad, by_time_rad = 0.3 * 0.05, 1.0 * 0.05
    assert driven.session.lead_rad == pytest.approx(by_speed_rad)
    assert driven.session.choose("time125") == ""
    driven.session.read()
    assert driven.session.lead_rad == pytest.approx(by_speed_rad), "the bridge has not taken it up yet"
    driven.bridge.step(2)
    driven.session.read()
    assert driven.session.lead_rad == pytest.approx(by_time_rad)


def test_clearing_where_there_is_no_fault_ends_driving_and_says_so(driven: DrivenArm) -> None:
    driven.drive(20)
    assert driven.session.clear() == ""
    assert "engagement-lost" in [step_event.name for step_event in driven.drive(1).step_events]


def test_a_controller_that_takes_no_commands_without_an_alarm_has_a_fault_that_clears_once_it_goes_on(
    driven: DrivenArm,
) -> None:
    driven.drive(20)
    driven.simulator.pause(True)
    record = driven.drive(5)
    assert record.decision.state == "faulted"
    assert record.decision.reason == "the controller is not ready: paused; when it is ready: station kassow clear"
    assert driven.session.clear() == "the controller is not ready: paused"
    driven.simulator.pause(False)
    assert driven.drive(5).decision.state == "faulted"
    assert driven.session.clear() == ""
    driven.control.cleared("ada")
    sends = driven.bridge.get_state().stream_j_sends
    record = driven.drive(200)
    assert (record.decision.state, record.decision.reason) == (
        "waiting", "there was a fault; let go, then engage anew"
    )  # fmt: skip
    assert driven.bridge.get_state().stream_j_sends == sends


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_joint_so_far_outside_its_range_that_no_target_reaches_into_it_is_named(side: float) -> None:
    middle = (LIMITS.q_min + LIMITS.q_max) / 2
    end = LIMITS.q_max if side > 0 else LIMITS.q_min
    near, far = middle.copy(), middle.copy()
    near[3], far[3] = end[3] + side * 0.014, end[3] + side * 0.02
    assert beyond_reach(near, LIMITS, 0.015) == ""
    said = beyond_reach(far, LIMITS, 0.015)
    assert said == "joint_4 is 0.02 rad outside its range of -1.222 to 3.142 rad; move it back at the controller"
