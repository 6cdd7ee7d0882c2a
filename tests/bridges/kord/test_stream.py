"""Streams of joint targets against the controller's rules, exact on a virtual clock: K1, K2, K5 to K9 of its table."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from station_kord import PROFILES

from tests.bridges.kord.arms import ONE_JOINT, STEP_RAD, arm, ids, stream


def test_k1_an_idle_loop_ticks_at_250_hz_and_sends_nothing() -> None:
    with arm() as bridge:
        state = bridge.step(2500)
        assert (state.tick, state.stream_j_sends, state.direct_sends, state.move_sends) == (2500, 0, 0, 0)
        assert (state.sync_timeouts, state.missed_ticks, state.late_commands) == (0, 0, 0)
        assert state.events == ()
        assert state.period_us.max == 4000.0


def test_k2_a_stream_is_sent_on_every_second_tick_and_the_arm_ends_at_its_last_target() -> None:
    with arm() as bridge:
        state = stream(bridge, 2500)
        assert state.stream_j_sends == 1250
        assert state.commands_dropped_by_throttle == 1249
        target = state.q_target[0]
        state = bridge.step(50)
        assert abs(state.q[0] - target) < 1e-9
        assert state.q_sent[0] == target
        assert state.stream_j_sends in (1250, 1251)
        assert not state.is_moving
        assert state.events == ()


@pytest.mark.parametrize(("preset", "seconds"), [("final", 1.8), ("narrative", 1.14)])
def test_k2_without_the_throttle_the_planner_overflows(preset: str, seconds: float) -> None:
    with arm(preset=preset) as bridge:
        bridge.set_throttle(1)
        state = stream(bridge, 1000, until=lambda state: state.is_faulted)
        assert ids(state) == [3001]
        assert state.tick * 0.004 == pytest.approx(seconds, abs=0.05)
        assert not state.is_engaged


def test_the_last_target_of_a_motion_is_sent_though_its_turn_comes_after_it() -> None:
    for length in (1, 2, 3, 4, 5, 8, 9):
        with arm("time125") as bridge:
            state = stream(bridge, length)
            target = state.q_target[0]
            state = bridge.step(20)
            assert state.q_sent[0] == target
            assert abs(state.q[0] - target) < 1e-9


def test_a_target_that_stays_is_sent_once() -> None:
    with arm() as bridge:
        q = bridge.get_state().q + 0.01 * ONE_JOINT
        for _ in range(250):
            bridge.stream_j(q)
            bridge.step(1)
        assert bridge.get_state().stream_j_sends == 1


def test_k5_stop_points_pile_up_a_hundred_seconds_of_motion_from_a_key_held_for_less_than_one() -> None:
    with arm("legacy-stop") as bridge:
        state = stream(bridge, 100, every=2)
        assert state.queued_motion_s == pytest.approx(100.0, abs=2.0)
        asked = state.q_target[0]
        state = bridge.step(round(90 / 0.004))
        assert state.is_moving
        assert state.q[0] < asked
        state = bridge.step(round(11 / 0.004))
        assert not state.is_moving
        assert abs(state.q[0] - asked) < 1e-9


@pytest.mark.parametrize("profile", ["speed125", "time125", "time250"])
def test_k5_via_points_never_owe_more_than_a_moment(profile: str) -> None:
    with arm(profile) as bridge:
        longest = 0.0
        for _ in range(100):
            longest = max(longest, stream(bridge, 1).queued_motion_s)
        assert 0.0 < longest <= 0.05
        assert not bridge.step(25).is_moving


def test_k6_a_hold_that_is_sent_again_and_again_suspends_the_arm() -> None:
    with arm("time250", resend_targets=True) as bridge:
        bridge.stream_j(bridge.get_state().q)
        first = bridge.step(1)
        while not bridge.step(1).is_faulted and bridge.get_state().tick < 1500:
            pass
        state = bridge.get_state()
        assert (state.tick - first.tick) * 0.004 == pytest.approx(2.98, abs=0.1)
        assert ids(state) == [3001]


def test_k6_a_hold_that_is_not_sent_lasts() -> None:
    with arm("time250") as bridge:
        bridge.stream_j(bridge.get_state().q)
        before = bridge.step(10)
        state = bridge.step(round(60 / 0.004))
        assert state.stream_j_sends == before.stream_j_sends
        assert state.planner_backlog == 0
        assert state.events == ()


@pytest.mark.parametrize(("offset_rad", "faults"), [(0.010, True), (0.001, False)])
def test_k7_a_target_too_far_for_its_time_ends_the_connection(offset_rad: float, faults: bool) -> None:
    profile = dataclasses.replace(PROFILES["time250"], offset_guard=False)
    with arm(profile) as bridge:
        bridge.stream_j(bridge.get_state().q + offset_rad * ONE_JOINT)
        state = bridge.step(30)
        assert (3002 in ids(state)) == faults
        assert state.is_connected != faults
        assert (state.sync_timeouts > 0) == faults
        assert abs(state.q[0] - (0.0 if faults else offset_rad)) < 1e-9


def test_k7_a_speed_takes_as_long_as_it_takes() -> None:
    with arm("speed125") as bridge:
        bridge.stream_j(bridge.get_state().q + 0.5 * ONE_JOINT)
        state = bridge.step(round(1.8 / 0.004))
        assert state.events == ()
        assert abs(state.q[0] - 0.5) < 1e-9


@pytest.mark.parametrize("profile", ["time125", "time250"])
@pytest.mark.parametrize("offset_rad", [0.010, 0.5, -2.0])
def test_k7_the_guard_goes_to_a_far_target_in_steps_that_are_feasible(profile: str, offset_rad: float) -> None:
    with arm(profile) as bridge:
        bridge.stream_j(bridge.get_state().q + offset_rad * ONE_JOINT)
        state = bridge.step(2000)
        assert state.events == ()
        assert state.slewed_sends > 0
        assert abs(state.q[0] - offset_rad) < 1e-6


@pytest.mark.parametrize("before", ["move", "velocity"])
@pytest.mark.parametrize("profile", ["time125", "time250"])
def test_k7_the_guard_starts_where_another_mode_has_left_the_arm(profile: str, before: str) -> None:
    with arm(profile) as bridge:
        if before == "move":
            bridge.move_j(0.5 * ONE_JOINT, speed_radps=1.0)
        for _ in range(300):
            if before == "velocity":
                bridge.velocity_j(0.3 * ONE_JOINT)
            bridge.step(1)
        state = bridge.step(60)
        assert not state.is_moving
        bridge.stream_j(state.q + 0.002 * ONE_JOINT)
        after = bridge.step(25)
        assert after.events == ()
        assert after.q[0] == pytest.approx(state.q[0] + 0.002, abs=1e-9)


@pytest.mark.parametrize(("preset", "suspends"), [("narrative", True), ("final", False)])
def test_k8_a_speed_at_125_hz_for_a_minute_depends_on_what_planning_costs(preset: str, suspends: bool) -> None:
    with arm(preset=preset) as bridge:
        state = stream(bridge, 15_000, speed_radps=0.1, until=lambda state: state.is_faulted)
        if suspends:
            assert ids(state) == [3001]
            assert state.tick * 0.004 == pytest.approx(25.0, abs=2.0)
        else:
            assert state.events == ()
            assert state.tick == 15_000


def test_k9_the_throttle_changes_the_rate_within_a_tick() -> None:
    with arm() as bridge:
        before = stream(bridge, 500)
        assert before.stream_j_sends == 250
        bridge.set_throttle(4)
        after = stream(bridge, 500)
        assert after.throttle == 4
        assert after.stream_j_sends - before.stream_j_sends in (125, 126)
        sent = np.flatnonzero(bridge.trace(500)["sent"])
        assert set(np.diff(sent)) == {4}


def test_a_stream_moves_the_arm_without_a_jump_of_its_speed() -> None:
    for profile in ("speed125", "time125", "time250"):
        with arm(profile) as bridge:
            stream(bridge, 250)
            bridge.step(50)
            rows = bridge.trace()
            speeds = np.diff(rows["q"][:, 0]) / 0.004
            assert speeds[100:200].mean() == pytest.approx(0.3, rel=0.02), profile
            assert np.abs(np.diff(speeds)).max() <= 0.2, profile
            assert speeds.min() >= 0.0, profile
            assert bridge.get_state().slewed_sends == 0, profile


def test_a_stream_that_turns_round_is_followed() -> None:
    with arm("time125") as bridge:
        q = bridge.get_state().q
        for tick in range(1000):
            q = q + STEP_RAD * np.sign(np.sin(tick / 20)) * ONE_JOINT
            bridge.stream_j(q)
            bridge.step(1)
        state = bridge.step(25)
        assert state.events == ()
        assert np.allclose(state.q, q, atol=1e-9)


@pytest.mark.parametrize("profile", ["time125", "time250"])
def test_the_guard_keeps_the_wildest_hand_feasible(profile: str) -> None:
    rng = np.random.default_rng(7)
    with arm(profile, buffer_len=100_000) as bridge:
        q = bridge.get_state().q
        for _ in range(400):
            q = np.clip(q + rng.uniform(-1, 1, 7) * rng.choice([1e-3, 1e-2, 0.3]), -1.0, 1.0)
            for _ in range(int(rng.integers(1, 12))):
                bridge.stream_j(q)
                state = bridge.step(1)
        assert state.events == ()
        assert np.allclose(bridge.step(1000).q, q, atol=1e-6)


@pytest.mark.parametrize(("strict", "seen"), [(False, []), (True, [3001])])
def test_r9_targets_that_cease_in_motion_halt_an_arm_whose_controller_minds(strict: bool, seen: list[int]) -> None:
    with arm(ceased_is_fault=strict) as bridge:
        bridge.stream_j(bridge.get_state().q + 0.5 * ONE_JOINT)  # 1.7 s of motion, and nothing follows
        state = bridge.step(500)
        assert ids(state) == seen
        assert state.is_faulted == strict


@pytest.mark.parametrize(("profile", "seen"), [("speed125", [3001]), ("time125", []), ("time250", [])])
def test_r9_streams_by_time_are_at_rest_before_such_a_controller_minds(profile: str, seen: list[int]) -> None:
    with arm(profile, ceased_is_fault=True) as bridge:
        assert stream(bridge, 250).events == ()
        assert ids(bridge.step(25)) == seen


def test_r9_a_move_that_stops_by_itself_is_none_that_ceases() -> None:
    with arm(ceased_is_fault=True) as bridge:
        bridge.move_j(0.3 * ONE_JOINT, speed_radps=0.5)
        state = bridge.step(250)
        assert abs(state.q[0] - 0.3) < 1e-9
        assert state.events == ()


def test_a_profile_waits_for_the_arm_to_stand_also_where_the_motion_is_still_to_begin() -> None:
    with arm() as bridge:
        bridge.set_throttle(250)
        bridge.stream_j(0.001 * ONE_JOINT)
        assert not bridge.step(60).is_moving
        bridge.stream_j(0.01 * ONE_JOINT)  # waits for its turn, and the arm stands
        assert not bridge.step(1).is_moving
        bridge.set_profile("time250")
        state = bridge.step(1)
        assert (state.profile, state.stream_j_sends) == ("speed125", 2)
        assert bridge.step(60).profile == "time250"
        assert bridge.get_state().throttle == 1
