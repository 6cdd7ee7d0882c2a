"""Where SONIC's planner is told to go and to look, as velocities, and back."""

from __future__ import annotations

import math

import numpy as np
import pytest

from adapters.sonic.message import BadMessage
from adapters.sonic.planner import (
    IDLE,
    MOST_TURN_RAD_S,
    OWN_SPEED_M_S,
    RUN,
    SLOW_WALK,
    SQUAT,
    WALK,
    Planned,
    PlannedVelocity,
    VelocityPlan,
)

DT_S = 0.02
AHEAD, LEFT, NOWHERE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.0)


def test_movement_is_seen_from_where_the_robot_looks() -> None:
    walk = PlannedVelocity(has_height=False)
    assert walk.command(Planned(SLOW_WALK, AHEAD, AHEAD, 0.5), 0.0) == pytest.approx([0.5, 0.0, 0.0])
    assert walk.command(Planned(SLOW_WALK, (0, 2, 0), AHEAD, 0.5), DT_S) == pytest.approx([0.0, 0.5, 0.0])
    walk.realign()
    assert walk.command(Planned(SLOW_WALK, LEFT, LEFT, 0.5), 2 * DT_S) == pytest.approx([0.5, 0.0, 0.0])


def test_a_facing_that_jumps_is_turned_to_at_a_bounded_rate_and_movement_keeps_its_way_in_the_world() -> None:
    walk, heading, place = PlannedVelocity(has_height=False), 0.0, np.zeros(2)
    walk.command(Planned(SLOW_WALK, NOWHERE, AHEAD), 0.0)
    for tick in range(1, 301):
        vx, vy, wz = walk.command(Planned(SLOW_WALK, AHEAD, LEFT, 0.5), tick * DT_S)
        assert abs(wz) <= MOST_TURN_RAD_S
        ahead = np.array([math.cos(heading), math.sin(heading)])
        place += DT_S * (vx * ahead + vy * np.array([-ahead[1], ahead[0]]))
        heading += DT_S * wz
    assert heading == pytest.approx(math.pi / 2, abs=0.01)
    assert place == pytest.approx([3.0, 0.0], abs=0.05)


@pytest.mark.parametrize("mode", [SLOW_WALK, WALK, RUN])
def test_a_mode_without_a_speed_has_its_own(mode: int) -> None:
    walk = PlannedVelocity(has_height=False)
    assert walk.command(Planned(mode, AHEAD, AHEAD), 0.0)[0] == OWN_SPEED_M_S[mode]


def test_a_robot_that_idles_stands_wherever_it_is_asked_to_look() -> None:
    walk = PlannedVelocity(has_height=False)
    walk.command(Planned(SLOW_WALK, AHEAD, AHEAD), 0.0)
    assert walk.command(Planned(IDLE, AHEAD, LEFT, 0.5), DT_S) == [0.0, 0.0, 0.0]


def test_a_squat_is_a_height_where_the_command_has_one_and_has_no_meaning_elsewhere() -> None:
    squat = Planned(SQUAT, AHEAD, LEFT, 0.5, 0.5)
    assert PlannedVelocity(has_height=True).command(squat, 0.0) == [0.0, 0.0, 0.0, 0.5]
    assert PlannedVelocity(has_height=True).command(Planned(WALK, NOWHERE, AHEAD, height=0.5), 0.0)[3] == 0.74
    with pytest.raises(BadMessage, match="mode 4 has no meaning for this command; expected 0 to 3"):
        PlannedVelocity(has_height=False).command(squat, 0.0)


@pytest.mark.parametrize("mode", [-1, 5, 8, 26, 2**31 - 1])
def test_other_modes_have_no_meaning(mode: int) -> None:
    with pytest.raises(BadMessage, match=f"mode {mode} has no meaning"):
        PlannedVelocity(has_height=True).command(Planned(mode, AHEAD, AHEAD), 0.0)


def test_velocities_become_a_mode_of_their_speed() -> None:
    plan = VelocityPlan()
    slow = plan.planned(np.array([0.0, 0.5, 0.0]), DT_S)
    assert (slow.mode, slow.speed, slow.facing) == (SLOW_WALK, 0.5, AHEAD)
    assert slow.movement == pytest.approx(LEFT)
    assert plan.planned(np.array([1.5, 0.0, 0.0]), DT_S).mode == WALK
    assert plan.planned(np.array([0.06, 0.0, 0.0]), DT_S).speed == 0.1, "SONIC knows no slower walk"
    still = plan.planned(np.zeros(3), DT_S)
    assert (still.mode, still.movement, still.speed) == (IDLE, NOWHERE, -1.0)
    turning = plan.planned(np.array([0.0, 0.0, 0.5]), DT_S)
    assert (turning.mode, turning.speed) == (SLOW_WALK, 0.0)


def test_there_and_back_again_is_the_same_walk() -> None:
    plan, walk = VelocityPlan(), PlannedVelocity(has_height=False)
    rng, velocity, sums = np.random.default_rng(3), np.zeros(3), np.zeros((2, 3))
    for tick in range(500):
        if tick % 50 == 0:
            velocity = rng.uniform([-0.7, -0.5, -0.8], [0.7, 0.5, 0.8])
        back = walk.command(plan.planned(velocity, DT_S), tick * DT_S)
        sums += DT_S * np.array([np.abs(velocity), np.abs(back)])
    assert sums[1] == pytest.approx(sums[0], rel=0.2), "what is left to turn is turned a little later"
