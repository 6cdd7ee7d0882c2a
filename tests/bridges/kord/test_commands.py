"""What an arm may be asked for, and what is refused in words."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from station_kord import (
    BACKEND,
    PROFILES,
    BadOption,
    KordBridge,
    Limits,
    NotConnected,
    OutOfLimits,
    Refused,
    SimOptions,
)

from adapters.robots.kassow.kinematics import KR810
from station.rotations import roll_pitch_yaw
from tests.bridges.kord.arms import LIMITS, ONE_JOINT, arm, stream


def test_this_build_tells_that_it_is_the_simulator() -> None:
    assert BACKEND == "sim"
    with arm() as bridge:
        assert bridge.get_state().backend == "sim"


def test_a_real_controller_is_refused_by_a_build_with_the_simulator() -> None:
    with pytest.raises(BadOption, match="simulator only"):
        KordBridge("192.168.39.1", limits=LIMITS)


def test_commands_need_a_session_and_an_engaged_arm() -> None:
    bridge = KordBridge(limits=LIMITS, sim=SimOptions(clock="virtual"), real_time_priority=0)
    q = np.zeros(7)
    for command in (bridge.engage, lambda: bridge.stream_j(q), bridge.clear_faults, bridge.step):
        with pytest.raises(NotConnected, match="connect"):
            command()
    bridge.connect()
    for command in (lambda: bridge.stream_j(q), lambda: bridge.velocity_j(q), lambda: bridge.direct_j(q)):
        with pytest.raises(Refused, match="not engaged"):
            command()
    bridge.engage()
    bridge.stream_j(q)
    bridge.disengage()
    with pytest.raises(Refused, match="not engaged"):
        bridge.stream_j(q)
    bridge.close()
    bridge.close()
    with pytest.raises(NotConnected):
        bridge.stream_j(q)


def test_counters_survive_connecting_again() -> None:
    with arm() as bridge:
        before = stream(bridge, 100)
        bridge.close()
        assert not bridge.get_state().is_connected
        after = bridge.connect()
        assert after.stream_j_sends == before.stream_j_sends
        assert after.tick >= before.tick
        assert not after.is_engaged
        bridge.step(30)
        bridge.engage()
        assert stream(bridge, 100).stream_j_sends == before.stream_j_sends + 50


def test_a_joint_beyond_its_limit_is_named() -> None:
    with arm() as bridge:
        q = bridge.get_state().q
        q[1] = -1.3
        for command in (bridge.stream_j, bridge.direct_j, bridge.move_j):
            with pytest.raises(OutOfLimits, match=r"joint 2 at -1\.3 rad is outside -1\.222 to 3\.142 rad"):
                command(q)
        with pytest.raises(OutOfLimits, match=r"joint 1 at 2\.1 rad/s is outside -2 to 2 rad/s"):
            bridge.velocity_j(2.1 * ONE_JOINT)
        with pytest.raises(OutOfLimits, match="speed"):
            bridge.move_j(np.zeros(7), speed_radps=9.0)
        assert bridge.step(5).stream_j_sends == 0


@pytest.mark.parametrize("bad", [[0.0] * 6, [0.0] * 8, [np.nan] * 7, [np.inf] + [0.0] * 6])
def test_a_target_that_is_not_seven_finite_numbers_is_refused(bad: list[float]) -> None:
    with arm() as bridge, pytest.raises(BadOption, match="7 finite numbers"):
        bridge.stream_j(bad)


def test_limits_without_a_range_are_refused() -> None:
    with pytest.raises(BadOption, match="joint 3 has no range"):
        dataclasses.replace(LIMITS, q_min=(*LIMITS.q_min[:2], 7.0, *LIMITS.q_min[3:]))
    with pytest.raises(BadOption, match="positive"):
        Limits(q_min=LIMITS.q_min, q_max=LIMITS.q_max, qd_max=(0.0,) * 7, qdd_max=LIMITS.qdd_max)


def test_angles_are_not_wrapped() -> None:
    with arm("speed125", q_start=(6.0,) + (0.0,) * 6) as bridge:
        bridge.move_j(6.2 * ONE_JOINT)
        state = bridge.step(400)
        assert state.q[0] == pytest.approx(6.2)


def test_a_mode_begins_at_standstill_only() -> None:
    with arm() as bridge:
        stream(bridge, 50)
        for command in (bridge.velocity_j, bridge.move_j):
            with pytest.raises(Refused, match="still moves by stream_j"):
                command(np.zeros(7))
        with pytest.raises(Refused, match="standstill"):
            bridge.set_profile("time125")
        with pytest.raises(Refused, match="still moves"):
            bridge.engage()
        bridge.step(30)
        bridge.velocity_j(0.1 * ONE_JOINT)
        assert bridge.step(5).mode == "velocity"


def test_a_direct_command_begins_where_the_arm_is() -> None:
    with arm() as bridge, pytest.raises(Refused, match="must be where the arm is"):
        bridge.direct_j(0.01 * ONE_JOINT)


def test_profiles_change_at_standstill_and_are_told() -> None:
    with arm() as bridge:
        assert (bridge.get_state().profile, bridge.get_state().throttle) == ("speed125", 2)
        bridge.set_profile("time250")
        state = bridge.step(1)
        assert (state.profile, state.throttle) == ("time250", 1)
        with pytest.raises(BadOption, match="speed125, time125"):
            bridge.set_profile("fast")
        with pytest.raises(BadOption, match="throttle"):
            bridge.set_throttle(0)


def test_the_profiles_are_those_of_the_table() -> None:
    assert {name: (p.tracking, p.tracking_value, p.blend_s, p.overlay, p.throttle) for name, p in PROFILES.items()} == {
        "speed125": ("joint-speed", 0.3, 0.008, "via-point", 2),
        "time125": ("time", 0.016, 0.008, "via-point", 2),
        "time250": ("time", 0.008, 0.004, "via-point", 1),
        "legacy-stop": ("time", 2.0, 0.0, "stop-point", 1),
    }


def test_hold_stops_a_stream_and_a_velocity() -> None:
    with arm() as bridge:
        stream(bridge, 100)
        bridge.hold()
        sends = bridge.get_state().stream_j_sends
        state = bridge.step(250)
        assert state.stream_j_sends == sends
        assert not state.is_moving
        assert state.is_engaged

        for _ in range(50):
            bridge.velocity_j(0.3 * ONE_JOINT)
            bridge.step(1)
        bridge.hold()
        state = bridge.step(25)
        assert np.all(state.qd == 0)
        assert state.events == ()
        sends = state.direct_sends
        assert bridge.step(250).direct_sends == sends, "0 Hz at hold"


def test_a_move_goes_to_its_joints_and_stops_there() -> None:
    with arm() as bridge:
        goal = np.array([0.3, 0.2, -0.1, 0.4, 0.0, -0.2, 0.1])
        bridge.move_j(goal, speed_radps=0.5)
        assert bridge.step(100).mode == "move-joints"
        state = bridge.step(150)
        assert np.allclose(state.q, goal, atol=1e-9)
        assert (state.move_sends, state.is_moving, state.mode) == (1, False, "idle")


def test_a_line_moves_the_tool_straight_and_keeps_what_does_not_change() -> None:
    with arm(q_start=(0.3, 0.5, 0.1, 1.0, 0.2, 0.8, 0.1)) as bridge:
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


def test_a_target_outside_the_controllers_own_range_is_event_2005() -> None:
    with arm(q_max=(0.01, *LIMITS.q_max[1:])) as bridge:
        bridge.stream_j(0.02 * ONE_JOINT)
        state = bridge.step(3)
        assert [event.id for event in state.events] == [2005]
        assert state.alarm_state == 2 | 4 << 4 | 2005 << 8
