"""Moves that the controller makes by itself: where they lead, and that they can be ended before."""

from __future__ import annotations

import numpy as np
import pytest
from station_kord import KordBridge, State

from adapters.robots.kassow.kinematics import KR810
from station.rotations import roll_pitch_yaw
from tests.bridges.kord.arms import LIMITS, ONE_JOINT, arm


def test_a_move_goes_to_its_joints_and_stops_there() -> None:
    with arm() as bridge:
        goal = np.array([0.3, 0.2, -0.1, 0.4, 0.0, -0.2, 0.1])
        bridge.move_j(goal, speed_radps=0.5)
        assert bridge.step(100).mode == "move-joints"
        state = bridge.step(150)
        assert np.allclose(state.q, goal, atol=1e-9)
        assert (state.move_sends, state.is_moving, state.mode) == (1, False, "idle")


LINE_FROM = (0.3, 0.5, 0.1, 1.0, 0.2, 0.8, 0.1)


def _moving(bridge: KordBridge, kind: str, ticks: int) -> State:
    if kind == "line":
        goal = bridge.get_state().tcp_pose + np.array([0.1, -0.1, 0.1, 0, 0, 0])
        bridge.move_l(goal, speed_mps=0.1)
    else:
        bridge.move_j(np.array(LINE_FROM) + 0.5 * ONE_JOINT, speed_radps=0.5)
    return bridge.step(ticks)


@pytest.mark.parametrize("kind", ["joints", "line"])
@pytest.mark.parametrize("end", ["hold", "disengage"])
def test_hold_and_disengaging_end_a_move_before_its_goal(kind: str, end: str) -> None:
    with arm(q_start=LINE_FROM) as bridge:
        before = _moving(bridge, kind, 120)
        assert before.is_moving
        getattr(bridge, end)()
        getattr(bridge, end)()  # again does no more
        state = bridge.step(60)
        assert (state.is_moving, state.mode, state.move_sends, state.events) == (False, "idle", 2, ())
        assert np.all(np.abs(state.q - before.q) <= np.abs(before.qd) * 0.1 + 1e-3)
        assert state.q_target == pytest.approx(state.q, abs=1e-9)
        speeds = bridge.trace(61)["qd"]
        assert np.abs(np.diff(speeds, axis=0)).max() <= LIMITS.qdd_max[0] * 0.004 * 1.2
        assert state.is_engaged == (end == "hold")
        bridge.engage()
        bridge.stream_j(state.q + 0.001 * ONE_JOINT)
        assert bridge.step(25).q[0] == pytest.approx(state.q[0] + 0.001, abs=1e-9)


@pytest.mark.parametrize("ticks", [1, 2, 3, 5, 10, 200, 235, 245, 248, 249, 250, 251])
def test_a_move_that_has_just_begun_or_is_all_but_over_is_held_without_going_beyond_its_goal(ticks: int) -> None:
    with arm(q_start=LINE_FROM, q_max=(LINE_FROM[0] + 0.5, *LIMITS.q_max[1:])) as bridge:
        _moving(bridge, "joints", ticks)
        bridge.hold()
        state = bridge.step(100)
        assert (state.is_moving, state.events) == (False, ())
        assert LINE_FROM[0] - 1e-9 <= bridge.trace()["q"][:, 0].max() <= LINE_FROM[0] + 0.5 + 1e-9


def test_a_move_that_no_tick_has_seen_is_held_by_not_being_sent() -> None:
    with arm() as bridge:
        bridge.move_j(0.5 * ONE_JOINT)
        bridge.hold()
        state = bridge.step(20)
        assert (state.move_sends, state.mode, state.q[0]) == (0, "idle", 0.0)


def test_a_line_moves_the_tool_straight_and_keeps_what_does_not_change() -> None:
    with arm(q_start=LINE_FROM) as bridge:
        begin = bridge.get_state().tcp_pose
        goal = begin + np.array([0.05, -0.04, 0.06, 0, 0, 0])
        bridge.move_l(goal, speed_mps=0.1)
        poses = []
        for _ in range(240):
            poses.append(bridge.step(1).tcp_pose)
        state = bridge.get_state()
        assert np.allclose(state.tcp_pose, goal, atol=1e-6)
        along = (goal - begin)[:3] / np.linalg.norm((goal - begin)[:3])
        offsets = np.array(poses)[:, :3] - begin[:3]
        assert np.abs(offsets - np.outer(offsets @ along, along)).max() < 1e-6
        assert np.abs(np.array(poses)[:, 3:] - begin[3:]).max() < 1e-6
        assert state.events == ()


def test_the_tool_is_where_the_stations_own_kinematics_have_it() -> None:
    q = np.array([0.3, 0.5, 0.1, 1.0, 0.2, 0.8, 0.1])
    pose = KR810.posture(q).pose
    with arm(q_start=tuple(q)) as bridge:
        told = bridge.get_state().tcp_pose
    assert np.allclose(told[:3], pose.position, atol=1e-9)
    assert np.allclose(told[3:], roll_pitch_yaw(pose.quat_wxyz), atol=1e-9)


def test_a_line_out_of_reach_is_infeasible() -> None:
    with arm() as bridge:
        bridge.move_l([3.0, 0, 0, 0, 0, 0])
        state = bridge.step(3000)
        assert state.events[0].id == 3002
