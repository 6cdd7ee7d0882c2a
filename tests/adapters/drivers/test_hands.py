"""Two hands drive two palms; sticks walk only in the mode for it; triggers close, grips open."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from adapters.drivers.hands import HandsDriver, HandsOptions
from adapters.retarget.arm_ik import SIDES
from adapters.robots.g1 import twist_keys
from station import rotations
from station.operator.deadman import Snapshot
from station.operator.sample import OperatorSample, Pose

from .operators import TICK_S, hand, hands

pytest.importorskip("mink")

START = replace(hands(0.0), controls={})


def engaged(options: HandsOptions | None = None, reading: OperatorSample = START) -> tuple[HandsDriver, Snapshot]:
    driver = HandsDriver(options)
    snapshot = Snapshot(driver.inspect(reading).input, driver.target)
    driver.step(reading, snapshot, TICK_S)
    return driver, snapshot


def moved(pose: Pose, *way: float) -> Pose:
    return Pose(pose.position + np.array(way), pose.quat_wxyz)


def test_palms_go_as_far_as_the_hands() -> None:
    driver, snapshot = engaged()
    # Inwards and up: the arms hang almost straight at the start, there is nothing to reach below or outside.
    reading = replace(START, left=moved(START.left, 0.05, -0.05, 0.1), right=moved(START.right, 0.05, 0.05, 0.1))
    for _ in range(150):
        driver.step(reading, snapshot, TICK_S)
    for side, inwards in zip(SIDES, (-0.05, 0.05), strict=True):
        way = driver.target[side].position - snapshot.target[side].position
        assert way == pytest.approx([0.05, inwards, 0.1], abs=0.01)


def test_a_scale_makes_ways_shorter() -> None:
    driver, snapshot = engaged(HandsOptions(scale=0.5))
    for _ in range(150):
        driver.step(replace(START, left=moved(START.left, 0.1, 0.0, 0.1)), snapshot, TICK_S)
    way = driver.target["left"].position - snapshot.target["left"].position
    assert way == pytest.approx([0.05, 0.0, 0.05], abs=0.01)


def test_an_operator_who_faces_left_reaches_forward_by_reaching_left() -> None:
    facing_left = rotations.from_rotation_vector([0.0, 0.0, math.pi / 2])
    reading = replace(START, head=Pose(np.zeros(3), facing_left))
    driver, snapshot = engaged(HandsOptions(heading="head"), reading)
    for _ in range(150):
        driver.step(replace(reading, left=moved(reading.left, 0.0, 0.08, 0.08)), snapshot, TICK_S)
    way = driver.target["left"].position - snapshot.target["left"].position
    assert way == pytest.approx([0.08, 0.0, 0.08], abs=0.01)


def test_one_hand_drives_one_palm_and_the_other_is_not_asked_for() -> None:
    alone = replace(START, left=None)
    assert HandsDriver().inspect(alone).why_not == "left is not tracked"
    driver, snapshot = engaged(HandsOptions(sides=("right",)), alone)
    for _ in range(100):
        driver.step(replace(alone, right=moved(alone.right, 0.05, 0.0, 0.1)), snapshot, TICK_S)
    assert driver.target["left"].position == pytest.approx(snapshot.target["left"].position, abs=5e-3)
    assert driver.target["right"].position[2] > snapshot.target["right"].position[2] + 0.08


def test_poses_of_zeros_before_data_are_refused() -> None:
    nothing = Pose(np.zeros(3), np.zeros(4))
    assert HandsDriver().inspect(replace(START, right=nothing)).why_not == "right has no orientation yet"


def test_sticks_walk_only_in_the_mode_for_it() -> None:
    driver, snapshot = engaged()
    assert driver.mode == "stand"
    pushed = replace(START, controls={"left_stick_y": 1.0})
    for _ in range(100):
        command = driver.step(pushed, snapshot, TICK_S)
    assert driver.is_still
    assert driver.next_mode() == "walk"
    for _ in range(200):
        command = driver.step(pushed, snapshot, TICK_S)
    assert not driver.is_still
    assert command[0] > 0.3


def test_the_trigger_closes_a_hand_within_a_fifth_of_a_second_and_the_grip_opens_it() -> None:
    driver, snapshot = engaged()
    left, right = twist_keys.action_hand("left"), twist_keys.action_hand("right")
    for _ in range(20):
        driver.step(replace(START, controls={"left_trigger": 0.3}), snapshot, TICK_S)
    assert driver.auxiliary[left] == pytest.approx([0.0, 1.0, 1.74, -1.57, -1.74, -1.57, -1.74])
    assert driver.auxiliary[right] == pytest.approx(np.zeros(7))
    for _ in range(10):
        driver.step(replace(START, controls={"left_grip": 1.0}), snapshot, TICK_S)
    assert driver.auxiliary[left] == pytest.approx(0.5 * np.array([0.0, 1.0, 1.74, -1.57, -1.74, -1.57, -1.74]))


def test_a_gamepad_opens_both_hands_with_its_bumper() -> None:
    driver, snapshot = engaged()
    for control in ("left_trigger", "right_trigger"):
        for _ in range(20):
            driver.step(replace(START, controls={control: 1.0}), snapshot, TICK_S)
    for _ in range(20):
        driver.step(replace(START, controls={"right_bumper": 1.0}), snapshot, TICK_S)
    for side in SIDES:
        assert driver.auxiliary[twist_keys.action_hand(side)] == pytest.approx(np.zeros(7))


def test_hands_that_jump_are_told() -> None:
    driver = HandsDriver()
    now = {"left": moved(hand(0.0, "left"), 0.0, 0.5, 0.0), "right": hand(0.0, "right")}
    assert driver.jump({side: hand(0.0, side) for side in SIDES}, now).startswith("left jumped 0.50 m")


@pytest.mark.parametrize("options", [{"sides": ()}, {"sides": ("left", "left")}, {"scale": 0.0}])
def test_options_that_cannot_be_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="expected"):
        HandsOptions(**options)


def test_arms_that_were_let_go_in_mid_swing_do_not_swing_on_when_they_are_taken_up_again() -> None:
    driver, snapshot = engaged()
    for tick in range(40):
        reading = replace(START, left=moved(START.left, 0.01 * tick, 0.0, 0.01 * tick))
        driver.step(reading, snapshot, TICK_S)
    driver.step(reading, None, TICK_S)
    again = Snapshot(driver.inspect(reading).input, driver.target)
    for _ in range(4):
        driver.step(reading, again, TICK_S)
    assert driver.target["left"].position == pytest.approx(again.target["left"].position, abs=1e-3)
