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

from tests.bridges.kord.arms import LIMITS, ONE_JOINT, arm, direct, stream


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
        with pytest.raises(OutOfLimits, match=r"joint 1 at 11 rad/s² is outside -10 to 10 rad/s²"):
            bridge.direct_j(np.zeros(7), None, 11.0 * ONE_JOINT)
        for speed_mps in (0.0, -0.1, 2.5, np.inf, np.nan):
            with pytest.raises(OutOfLimits, match="m/s is not above 0 and 2 m/s at most"):
                bridge.move_l(np.zeros(6), speed_mps=speed_mps)
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


@pytest.mark.parametrize(
    ("step_rad", "change_radps"), [(0.02, 0.0), (-0.02, 0.0), (0.0, 0.2), (0.0, -0.5)],
    ids=["too far", "too far back", "too sudden", "too sudden a stop"],
)  # fmt: skip
def test_a_direct_command_beyond_what_a_joint_may_do_in_a_tick_is_not_sent(
    step_rad: float, change_radps: float
) -> None:
    with arm(torque_deviation_rad=1.0) as bridge:
        before = direct(bridge, 50, 0.3)
        leap = before.q_sent + (0.3 * 0.004 + step_rad) * ONE_JOINT
        for _ in range(50):
            bridge.direct_j(leap, (0.3 + change_radps) * ONE_JOINT)
            state = bridge.step(1)
            leap = state.q_sent + (0.3 * 0.004 + step_rad) * ONE_JOINT
            if state.mode == "idle":
                break
        assert state.limit_refusals > before.limit_refusals
        assert np.all(state.qd == 0.0), "refused commands renew nothing"
        rows = bridge.trace(50)
        assert np.abs(np.diff(rows["q_sent"][:, 0])).max() <= 0.3 * 0.004 + 1e-9
        assert state.events == ()


def test_profiles_change_at_standstill_and_are_told() -> None:
    with arm() as bridge:
        assert (bridge.get_state().profile, bridge.get_state().throttle) == ("speed125", 2)
        bridge.set_profile("time250")
        state = bridge.step(1)
        assert (state.profile, state.throttle) == ("time250", 1)
        with pytest.raises(BadOption, match="speed125, time125"):
            bridge.set_profile("fast")
        for ticks in (0, -1, 251):
            with pytest.raises(BadOption, match=f"throttle: 1 to 250 ticks of 4 ms are expected, not {ticks}"):
                bridge.set_throttle(ticks)


@pytest.mark.parametrize(
    "wrong",
    [
        {"throttle": 0}, {"throttle": 251}, {"tracking_value": 0.0}, {"tracking_value": np.nan},
        {"tracking_value": np.inf}, {"blend_s": -0.001}, {"blend_s": np.nan}, {"guard_qdd_radps2": np.nan},
        {"guard_qdd_radps2": 0.0},
    ],
    ids=str,
)  # fmt: skip
def test_a_profile_with_a_number_that_is_none_is_refused_by_the_bridge_itself(wrong: dict[str, float]) -> None:
    profile = dataclasses.replace(PROFILES["time125"], name="mine", **wrong)
    message = rf"profile 'mine': .*{next(iter(wrong))}"
    with pytest.raises(BadOption, match=message):
        KordBridge(limits=LIMITS, profile=profile, sim=SimOptions(clock="virtual"))
    with arm() as bridge:
        with pytest.raises(BadOption, match=message):
            bridge.set_profile(profile)
        assert bridge.step(2).profile == "speed125"


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


@pytest.mark.parametrize("speed_radps", [2.001, 100.0])
def test_a_stream_is_no_faster_than_the_slowest_joint_may_be(speed_radps: float) -> None:
    profile = dataclasses.replace(PROFILES["speed125"], name="mine", tracking_value=speed_radps)
    with pytest.raises(BadOption, match=r"profile 'mine': tracking_value must be a speed of 2 rad/s at most"):
        KordBridge(limits=LIMITS, profile=profile, sim=SimOptions(clock="virtual"))
    with arm() as bridge, pytest.raises(BadOption, match="at most"):
        bridge.set_profile(profile)


def test_a_target_outside_the_controllers_own_range_is_event_2005() -> None:
    with arm(q_max=(0.01, *LIMITS.q_max[1:])) as bridge:
        bridge.stream_j(0.02 * ONE_JOINT)
        state = bridge.step(3)
        assert [event.id for event in state.events] == [2005]
        assert state.alarm_state == 2 | 4 << 4 | 2005 << 8
