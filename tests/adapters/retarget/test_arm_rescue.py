"""When an arm is led back."""

from __future__ import annotations

import numpy as np

from adapters.retarget.body_ik import ArmRescue

DOWN, FORWARD, BACK = np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.0])
DT_S = 1.0 / 90.0


def ways(rescue: ArmRescue, seconds: float, wanted: np.ndarray, found: np.ndarray, away_rad: float = 1.0) -> list[str]:
    return [rescue.step(wanted, found, away_rad, DT_S) for _ in range(round(seconds / DT_S))]


def test_an_arm_that_only_catches_up_with_a_leap_follows() -> None:
    rescue = ArmRescue()
    assert set(ways(rescue, 0.35, DOWN, FORWARD)) == {"follows"}
    assert set(ways(rescue, 1.0, DOWN, DOWN)) == {"follows"}
    assert set(ways(rescue, 0.35, DOWN, FORWARD)) == {"follows"}
    assert rescue.rescues == 0


def test_an_arm_that_is_caught_goes_by_the_standing_pose_and_follows_again() -> None:
    rescue = ArmRescue()
    assert ways(rescue, 0.5, DOWN, FORWARD)[-1] == "frees"
    assert ways(rescue, 0.5, DOWN, FORWARD)[-1] == "frees"
    assert rescue.step(DOWN, FORWARD, 0.1, DT_S) == "returns"
    assert rescue.step(DOWN, DOWN, 0.5, DT_S) == "follows"
    assert rescue.rescues == 1


def test_where_no_arm_can_be_it_is_tried_once() -> None:
    rescue = ArmRescue()
    seen = ways(rescue, 30.0, BACK, FORWARD)
    assert rescue.rescues == 1
    assert seen[-1] == "follows"
    ways(rescue, 1.0, DOWN, FORWARD)
    assert rescue.rescues == 2, "asked to point elsewhere, it is tried again"


def test_no_way_takes_for_ever_and_a_reset_ends_it() -> None:
    rescue = ArmRescue()
    ways(rescue, 0.5, DOWN, FORWARD)
    assert ways(rescue, 2.1, DOWN, FORWARD)[-1] == "returns"
    rescue.reset()
    assert (rescue.way, rescue.rescues) == ("follows", 0)
