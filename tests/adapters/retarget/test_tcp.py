"""One tool by one hand: the same movement within speeds and box, at once."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.retarget.tcp_ik import TcpFollower
from station import rotations
from station.operator.deltas import angle_between, followed
from station.operator.sample import Pose

TICK_S = 0.01
START = Pose(np.array([0.4, 0.0, 0.3]), np.array([1.0, 0.0, 0.0, 0.0]))
LOWER, UPPER = np.array([0.2, -0.3, 0.05]), np.array([0.7, 0.3, 0.6])


def follower() -> TcpFollower:
    return TcpFollower(START, lower=LOWER, upper=UPPER)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-2.0, 2.0)] * 6), min_size=1, max_size=20))
def test_whatever_is_asked_for_box_and_speeds_are_kept(goals: list[tuple[float, ...]]) -> None:
    tool, before = follower(), START
    for goal in goals:
        pose = Pose(np.array(goal[:3]), rotations.from_rotation_vector(np.array(goal[3:])))
        for _ in range(30):
            now = tool.step(pose, TICK_S)
            assert np.linalg.norm(now.position - before.position) <= 0.5 * TICK_S + 1e-12
            assert angle_between(before.quat_wxyz, now.quat_wxyz) <= 1.5 * TICK_S + 1e-6
            assert (now.position >= LOWER - 1e-12).all()
            assert (now.position <= UPPER + 1e-12).all()
            before = now


def test_a_hand_that_is_slow_enough_is_followed_at_once() -> None:
    tool, hand = follower(), Pose(np.array([1.0, 2.0, 1.0]), rotations.from_rotation_vector([0.0, 0.0, 1.0]))
    for tick in range(100):
        turn = rotations.from_rotation_vector([0.0, 0.005 * tick, 0.0])
        now = Pose(hand.position + np.array([0.002, 0.0, 0.001]) * tick, rotations.multiply(turn, hand.quat_wxyz))
        goal = followed(START, hand, now)
        assert tool.step(goal, TICK_S).position == pytest.approx(goal.position)
        assert angle_between(tool.pose.quat_wxyz, goal.quat_wxyz) == pytest.approx(0.0, abs=1e-6)
    assert rotations.roll_pitch_yaw(tool.pose.quat_wxyz)[1] == pytest.approx(0.495, abs=1e-6)


def test_at_a_side_of_the_box_the_tool_slides_along_it() -> None:
    tool = follower()
    for _ in range(200):
        tool.step(Pose(np.array([0.9, 0.2, 0.3]), START.quat_wxyz), TICK_S)
    assert tool.pose.position == pytest.approx([0.7, 0.2, 0.3])


def test_a_tool_outside_its_box_does_not_jump_into_it() -> None:
    outside = Pose(np.array([0.8, 0.0, 0.3]), START.quat_wxyz)
    tool = follower()
    tool.reset(outside)
    assert tool.step(outside, TICK_S).position == pytest.approx(outside.position)
    assert tool.step(Pose(np.array([0.9, 0.0, 0.3]), START.quat_wxyz), TICK_S).position[0] == pytest.approx(0.8)
    assert tool.step(START, TICK_S).position[0] < 0.8
