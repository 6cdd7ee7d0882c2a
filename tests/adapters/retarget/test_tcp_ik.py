"""Inverse kinematics of an arm, tick by tick: it arrives, and never leaves ranges and speeds on its way."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.retarget import tcp_ik
from adapters.robots import arm_limits
from adapters.robots.kassow.kinematics import KR810, REACHING_DOWN
from station.operator import deltas
from station.operator.sample import Pose
from station.protocols import Floats
from tests.examples import examples

LIMITS = arm_limits.load("kassow", "kr810")
LOWER, UPPER = LIMITS.q_min + arm_limits.SOFT_MARGIN_RAD, LIMITS.q_max - arm_limits.SOFT_MARGIN_RAD
DOWN = np.array(REACHING_DOWN)
TICK_RAD = 0.3 * 0.004

within = st.tuples(*(st.floats(low, high) for low, high in zip(LOWER.tolist(), UPPER.tolist(), strict=True)))


def distance(q: Floats, goal: Pose) -> tuple[float, float]:
    here = KR810.posture(q).pose
    metres = float(np.linalg.norm(here.position - goal.position))
    return metres, deltas.angle_between(here.quat_wxyz, goal.quat_wxyz)


def ticks_to(goal: Pose, reach_rad: float, most: int) -> int | None:
    """Return how many ticks it took to a tenth of a millimetre and a milliradian; None where it did not arrive."""
    q = DOWN.copy()
    for tick in range(most):
        q = tcp_ik.step(KR810, q, goal, reach_rad, LOWER, UPPER, DOWN)
        metres, radians = distance(q, goal)
        if metres < 1e-4 and radians < 1e-3:
            return tick + 1
    return None


# Goals are where joints are that differ from REACHING_DOWN by up to so much each; the last column is what must arrive.
@pytest.mark.parametrize(
    ("spread_rad", "reach_rad", "most", "goals", "part"),
    [
        (0.3, TICK_RAD, 400, 10, 1.0),
        (0.3, 1.0, 10, 50, 1.0),
        (0.8, 0.1, 60, 50, 1.0),
        (1.6, 0.1, 300, 40, 0.9),  # the rest end in a fold that is not the one the goal was made with, at a limit
    ],
)
def test_it_arrives(spread_rad: float, reach_rad: float, most: int, goals: int, part: float) -> None:
    random = np.random.default_rng(7)
    asked = [np.clip(DOWN + random.uniform(-spread_rad, spread_rad, 7), LOWER, UPPER) for _ in range(goals)]
    arrived = [ticks_to(KR810.posture(q).pose, reach_rad, most) is not None for q in asked]
    assert np.mean(arrived) >= part


@settings(max_examples=examples(60), deadline=None)
@given(q=within, goal=within, reach_rad=st.sampled_from([TICK_RAD, 0.05]), away=st.floats(0.0, 3.0))
def test_no_joint_leaves_its_range_or_is_faster_whatever_is_asked_and_from_wherever(
    q: tuple[float, ...], goal: tuple[float, ...], reach_rad: float, away: float
) -> None:
    here = np.array(q)
    asked = KR810.posture(np.array(goal)).pose
    asked = Pose(asked.position + away, asked.quat_wxyz)  # mostly out of reach
    for _ in range(20):
        there = tcp_ik.step(KR810, here, asked, reach_rad, LOWER, UPPER, DOWN)
        assert np.isfinite(there).all()
        assert (there >= LOWER).all()
        assert (there <= UPPER).all()
        assert np.abs(there - here).max() <= reach_rad + 1e-12
        here = there


def test_at_its_goal_it_does_not_move() -> None:
    assert tcp_ik.step(KR810, DOWN, KR810.posture(DOWN).pose, 1.0, LOWER, UPPER, DOWN) == pytest.approx(DOWN, abs=1e-9)


def test_stretched_out_it_moves_no_wilder_than_anywhere() -> None:
    upright = np.zeros(7)
    higher = KR810.posture(upright).pose
    higher = Pose(higher.position + np.array([0.0, 0.0, 0.01]), higher.quat_wxyz)
    assert np.abs(tcp_ik.step(KR810, upright, higher, 10.0, LOWER, UPPER, upright) - upright).max() < 0.5


def test_what_a_joint_at_its_end_may_not_do_the_others_do() -> None:
    q = DOWN.copy()
    upper = UPPER.copy()
    upper[3] = q[3]  # the elbow may fold no further
    goal = KR810.posture(q).pose
    goal = Pose(goal.position + np.array([-0.03, 0.0, 0.0]), goal.quat_wxyz)
    for _ in range(50):
        q = tcp_ik.step(KR810, q, goal, 0.05, LOWER, upper, DOWN)
        assert q[3] <= upper[3]
    metres, radians = distance(q, goal)
    assert metres < 1e-3
    assert radians < 1e-2


def test_where_a_joint_would_be_too_fast_the_tool_keeps_its_direction() -> None:
    goal = KR810.posture(DOWN).pose
    goal = Pose(goal.position + np.array([0.05, 0.02, -0.03]), goal.quat_wxyz)
    moved = KR810.posture(tcp_ik.step(KR810, DOWN, goal, TICK_RAD, LOWER, UPPER, DOWN)).position
    way, asked = moved - KR810.posture(DOWN).position, np.array([0.05, 0.02, -0.03])
    assert way @ asked / (np.linalg.norm(way) * np.linalg.norm(asked)) > 0.999
