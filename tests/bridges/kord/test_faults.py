"""Faults of the controller and the way back: K3, K4, K10, K11 of its table."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from station_kord import NotConnected, Refused

from tests.bridges.kord.arms import LIMITS, ONE_JOINT, STEP_RAD, arm, direct, drive, ids, stream


def test_k3_reading_before_sending_is_a_torque_deviation_as_soon_as_the_arm_moves() -> None:
    with arm(order="fetch-first") as bridge:
        state = stream(bridge, 100, until=lambda state: state.is_faulted)
        assert ids(state) == [1010]
        rows = bridge.trace()
        moved = np.flatnonzero(np.abs(rows["qd"][:, 0]) > 0.01)[0]
        assert 0 <= np.flatnonzero(rows["fault"])[0] - moved <= 3
        assert state.late_commands == state.stream_j_sends == rows["late"].sum()


def test_k3_reading_before_sending_harms_nobody_who_rests() -> None:
    with arm(order="fetch-first", resend_targets=True) as bridge:
        bridge.stream_j(bridge.get_state().q)
        state = bridge.step(200)
        assert state.late_commands > 3
        assert state.events == ()


@pytest.mark.parametrize(("speed_radps", "faults"), [(0.3, True), (0.1, False)])
def test_k4_one_late_direct_command_faults_a_fast_arm(speed_radps: float, faults: bool) -> None:
    with arm() as bridge:
        state = direct(bridge, 100, speed_radps)
        assert state.events == ()
        assert bridge.simulator is not None
        bridge.simulator.delay_commands(1)
        q = state.q_target.copy()
        for _ in range(4):
            q[0] += speed_radps * 0.004
            if bridge.get_state().is_faulted:
                break
            bridge.direct_j(q, speed_radps * ONE_JOINT)
            bridge.step(1)
        state = bridge.get_state()
        assert ids(state) == ([1010] if faults else [])
        assert state.late_commands == 1


def test_k10_after_a_fault_the_arm_starts_from_where_it_is_and_only_when_engaged_anew() -> None:
    with arm() as bridge:
        state = stream(bridge, 250)
        assert bridge.simulator is not None
        bridge.simulator.raise_event(1010)
        state = bridge.step(10)
        assert (state.is_faulted, state.is_engaged, state.fault_count) == (True, False, 1)
        assert not state.is_moving
        with pytest.raises(Refused, match="faulted"):
            bridge.stream_j(state.q + STEP_RAD)
        with pytest.raises(Refused, match="clear"):
            bridge.engage()

        state = bridge.clear_faults()
        assert (state.is_faulted, state.alarm_state) == (False, 0)
        with pytest.raises(Refused, match="not engaged"):
            bridge.stream_j(state.q)
        sent = bridge.step(50).stream_j_sends
        assert sent == bridge.step(1).stream_j_sends, "an old target was sent"

        q = bridge.engage()
        assert np.allclose(q, bridge.get_state().q, atol=1e-6)
        bridge.stream_j(q)
        state = bridge.step(2)
        assert state.stream_j_sends == sent + 1
        assert np.allclose(state.q_sent, q, atol=1e-6)
        assert not stream(bridge, 250).events[1:]


def test_k10_a_lost_connection_is_opened_anew_by_clearing() -> None:
    with arm() as bridge:
        stream(bridge, 100)
        assert bridge.simulator is not None
        bridge.simulator.raise_event(3002)
        lost = bridge.step(30)
        assert not lost.is_connected
        with pytest.raises(NotConnected):
            bridge.stream_j(lost.q)
        state = bridge.clear_faults()
        assert state.is_connected
        assert not state.is_faulted
        assert state.tick > lost.tick, "counters go on"
        bridge.engage()
        assert stream(bridge, 100).stream_j_sends > lost.stream_j_sends


@pytest.mark.parametrize("condition", [1010, 2002, 2005, 3001, 3002])
def test_every_fault_can_be_cleared(condition: int) -> None:
    with arm() as bridge:
        assert bridge.simulator is not None
        bridge.simulator.raise_event(condition)
        state = bridge.step(5)
        assert ids(state)[0] == condition
        assert not bridge.clear_faults().is_faulted
        bridge.engage()
        stream(bridge, 50)
        assert not bridge.step(25).is_moving


def test_clearing_without_an_alarm_sends_nothing_and_is_done_at_once() -> None:
    with arm() as bridge:
        tick = bridge.get_state().tick
        assert not bridge.clear_faults().is_faulted
        assert bridge.get_state().tick <= tick + 1


def test_an_emergency_stop_needs_a_person() -> None:
    with arm() as bridge:
        stream(bridge, 50)
        assert bridge.simulator is not None
        bridge.simulator.emergency_stop(True)
        state = bridge.step(10)
        assert state.needs_user_confirmation
        assert not state.is_moving
        with pytest.raises(Refused, match="person"):
            bridge.clear_faults()
        bridge.simulator.emergency_stop(False)
        bridge.step(1)
        with pytest.raises(Refused, match="person"):
            bridge.clear_faults()
        bridge.simulator.confirm()
        bridge.step(1)
        assert not bridge.clear_faults().is_faulted


def test_a_failure_that_no_request_clears_is_asked_for_nothing_and_told_after_the_deadline() -> None:
    with arm() as bridge:
        stream(bridge, 50)
        assert bridge.simulator is not None
        bridge.simulator.raise_event(900)
        state = bridge.step(5)
        assert [(event.id, event.group) for event in state.events] == [(900, "hardware")]
        with pytest.raises(Refused, match=r"not cleared within 0\.5 s; look at the controller's own display"):
            bridge.clear_faults(0.5)
        state = bridge.get_state()
        assert (state.is_faulted, state.alarm_state & 0xF) == (True, 3)


@pytest.mark.parametrize("mode", ["stream", "velocity", "direct", "move"])
def test_a_controller_that_is_paused_ends_the_engagement_and_hears_nothing_more(mode: str) -> None:
    with arm() as bridge:
        drive(bridge, mode, 100)
        assert bridge.simulator is not None
        bridge.simulator.pause(True)
        bridge.step(1)  # the heartbeat that tells of it
        state = bridge.step(1)
        assert (state.is_engaged, state.not_ready, state.is_faulted) == (False, "paused", False)
        sent = (state.stream_j_sends, state.direct_sends, state.move_sends)
        for command in (bridge.engage, lambda: bridge.stream_j(state.q), lambda: bridge.velocity_j(ONE_JOINT)):
            with pytest.raises(Refused, match="paused"):
                command()
        state = bridge.step(50)
        assert (state.stream_j_sends, state.direct_sends, state.move_sends) == sent
        assert (state.mode, state.is_moving, state.events) == ("idle", False, ())
        assert np.all(state.q_target == state.q)

        bridge.simulator.pause(False)
        state = bridge.step(5)
        assert (state.is_engaged, state.not_ready) == (False, "")
        with pytest.raises(Refused, match="not engaged"):
            bridge.stream_j(state.q)
        bridge.engage()
        state = stream(bridge, 50)
        assert (state.is_engaged, state.events) == (True, ())
        assert not bridge.step(25).is_moving


def test_heartbeats_that_cease_lose_the_session_and_disengage() -> None:
    with arm() as bridge:
        stream(bridge, 50)
        assert bridge.simulator is not None
        bridge.simulator.silence(True)
        state = bridge.step(30)
        assert not state.is_connected
        assert state.events[-1].group == "connection"
        with pytest.raises(NotConnected, match="answer"):
            bridge.clear_faults(0.5)
        bridge.simulator.silence(False)
        state = bridge.step(20)
        assert state.is_connected
        assert not state.is_engaged
        assert not state.is_moving


def test_k11_a_velocity_that_nobody_renews_is_zero_after_100_ms() -> None:
    with arm() as bridge:
        for _ in range(100):
            bridge.velocity_j(0.3 * ONE_JOINT)
            bridge.step(1)
        assert bridge.get_state().qd[0] == pytest.approx(0.3)
        bridge.step(5)
        assert bridge.get_state().qd[0] == pytest.approx(0.3), "20 ms are nobody's silence"
        state = bridge.step(21)
        assert np.all(state.qd == 0.0)
        assert state.mode == "idle"
        assert not bridge.step(10).is_moving
        assert bridge.get_state().events == ()


def test_k11_a_stream_that_nobody_renews_holds_its_last_target() -> None:
    with arm() as bridge:
        state = stream(bridge, 250)
        target = state.q_target[0]
        state = bridge.step(2500)
        assert abs(state.q[0] - target) < 1e-9
        assert state.events == ()


def test_k11_a_direct_motion_that_nobody_renews_comes_to_rest() -> None:
    with arm() as bridge:
        direct(bridge, 100, 0.3)
        state = bridge.step(30)
        assert np.all(state.qd == 0.0)
        assert state.events == ()
        assert bridge.step(10).mode == "idle"


@pytest.mark.parametrize("mode", ["stream", "velocity", "direct", "move"])
def test_closing_in_motion_leaves_the_arm_at_rest(mode: str) -> None:
    with arm() as bridge:
        drive(bridge, mode, 100)
        assert bridge.get_state().is_moving
        before = bridge.simulator.tick if bridge.simulator else 0
        bridge.close()
        assert bridge.simulator is not None
        rows = bridge.simulator.trace(bridge.simulator.tick - before + 1)
        assert len(rows) <= (51 if mode != "move" else 71)
        assert rows["fault"].sum() == 0
        if mode != "stream":
            assert np.all(rows[-1]["qd"] == 0.0)


def test_velocities_speed_up_within_their_limits_and_stop_before_the_end_of_a_joint() -> None:
    limits = dataclasses.replace(LIMITS, q_max=(0.2, *LIMITS.q_max[1:]), qdd_max=(2.0,) * 7)
    with arm(limits=limits) as bridge:
        for _ in range(500):
            bridge.velocity_j(0.5 * ONE_JOINT)
            bridge.step(1)
        state = bridge.get_state()
        assert state.events == ()
        assert state.q[0] == pytest.approx(0.2, abs=2e-3)
        assert state.q[0] <= 0.2 + 1e-9
        rows = bridge.trace()
        assert np.abs(np.diff(rows["qd"][:, 0])).max() <= 2.0 * 0.004 * 1.5
