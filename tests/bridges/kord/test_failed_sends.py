"""Commands that could not leave this machine: the last one of a motion leaves in the end, and none is a jump."""

from __future__ import annotations

import numpy as np
import pytest
from station_kord import KordBridge

from tests.bridges.kord.arms import ONE_JOINT, SPEED_RADPS, arm, direct, drive, stream


@pytest.mark.parametrize("profile", ["speed125", "time125", "time250"])
@pytest.mark.parametrize("length", [50, 51])
def test_a_target_that_could_not_leave_is_sent_in_the_next_tick(profile: str, length: int) -> None:
    with arm(profile) as bridge:
        state = stream(bridge, length)
        assert bridge.simulator is not None
        bridge.simulator.fail_sends(3)
        last = state.q_target + 0.0012 * ONE_JOINT
        bridge.stream_j(last)
        failing = bridge.step(2)
        assert failing.failed_sends > 0
        assert failing.q_sent[0] < last[0], "what has not left was not sent"
        state = bridge.step(30)
        assert (state.failed_sends, state.events) == (3, ())
        assert state.q_sent[0] == last[0]
        assert state.q[0] == pytest.approx(last[0], abs=1e-9)


@pytest.mark.parametrize("profile", ["time125", "time250"])
def test_a_far_target_is_approached_in_feasible_steps_though_some_could_not_leave(profile: str) -> None:
    with arm(profile) as bridge:
        bridge.stream_j(bridge.get_state().q + 0.5 * ONE_JOINT)
        for _ in range(40):
            bridge.step(7)
            assert bridge.simulator is not None
            bridge.simulator.fail_sends(1)
        state = bridge.step(1000)
        assert state.events == ()
        assert state.failed_sends > 5
        assert state.q[0] == pytest.approx(0.5, abs=1e-6)


def test_a_move_and_a_velocity_survive_a_command_that_could_not_leave() -> None:
    with arm() as bridge:
        assert bridge.simulator is not None
        bridge.simulator.fail_sends(2)
        bridge.move_j(0.1 * ONE_JOINT, speed_radps=0.5)
        state = bridge.step(100)
        assert (state.move_sends, state.failed_sends) == (1, 2)
        assert state.q[0] == pytest.approx(0.1, abs=1e-9)
        bridge.simulator.fail_sends(1)  # the first: where the arm is
        for tick in range(100):
            bridge.velocity_j(0.1 * ONE_JOINT)
            bridge.step(1)
            if tick == 50:
                bridge.simulator.fail_sends(1)
        assert bridge.step(30).failed_sends == 4
        assert bridge.get_state().events == ()
        assert not bridge.get_state().is_moving


def _end(bridge: KordBridge, mode: str) -> None:
    """Bring a motion to where one command more ends it."""
    if mode == "direct":
        state = direct(bridge, 50, SPEED_RADPS)
        q, speed = state.q_sent.copy(), SPEED_RADPS
        while speed > 0.03:
            speed -= 0.03
            q[0] += speed * 0.004
            bridge.direct_j(q, speed * ONE_JOINT)
            bridge.step(1)
        bridge.direct_j(q, None)
        return
    drive(bridge, "velocity", 50)
    if mode == "ending velocity":  # by its own decay, whose last command is the 25th
        bridge.step(23)
        return
    for speed in (0.1, 0.01, 0.0):
        for _ in range(20):
            bridge.velocity_j(speed * ONE_JOINT)
            if speed == 0.0 and bridge.get_state().qd[0] <= 0.04:
                return
            bridge.step(1)


@pytest.mark.parametrize("mode", ["velocity", "ending velocity", "direct"])
@pytest.mark.parametrize("failing", [1, 2, 3, 20])
def test_the_last_command_of_a_motion_leaves_in_the_end_though_its_sending_failed(mode: str, failing: int) -> None:
    with arm() as bridge:
        _end(bridge, mode)
        assert bridge.simulator is not None
        before = bridge.get_state()
        assert before.qd[0] > 0.0
        bridge.simulator.fail_sends(failing)
        state = bridge.step(failing)
        assert (state.failed_sends, state.direct_sends) == (failing, before.direct_sends)
        state = bridge.step(1)
        assert (state.direct_sends, state.failed_sends) == (before.direct_sends + 1, failing)
        last = state.q_sent
        state = bridge.step(30)
        assert (state.direct_sends, state.mode, state.is_moving, state.events) == (
            before.direct_sends + 1,
            "idle",
            False,
            (),
        )
        assert state.q == pytest.approx(last, abs=1e-9)


@pytest.mark.parametrize("mode", ["velocity", "direct"])
@pytest.mark.parametrize("failing", [1, 2, 3, 10, 40])
def test_a_motion_whose_commands_could_not_leave_for_long_does_not_jump_on(mode: str, failing: int) -> None:
    with arm() as bridge:
        drive(bridge, mode, 50)
        assert bridge.simulator is not None
        bridge.simulator.fail_sends(failing)
        for _ in range(150):
            if mode == "velocity":
                bridge.velocity_j(SPEED_RADPS * ONE_JOINT)
            state = bridge.step(1)
        assert state.events == ()
        assert state.qd[0] == (pytest.approx(SPEED_RADPS) if mode == "velocity" else 0.0)
        rows = bridge.trace(220)
        sent = rows["q_sent"][:, 0]
        assert np.abs(np.diff(sent)).max() <= SPEED_RADPS * 0.004 * 2 + 1e-9
        assert state.limit_refusals == (failing > 1), "what was cut off is counted once"


def test_heartbeats_that_were_missed_in_a_velocity_do_not_make_the_arm_jump() -> None:
    with arm() as bridge:
        drive(bridge, "velocity", 50)
        assert bridge.simulator is not None
        bridge.simulator.silence(True)
        bridge.step(8)
        bridge.simulator.silence(False)
        for _ in range(100):
            bridge.velocity_j(SPEED_RADPS * ONE_JOINT)
            state = bridge.step(1)
        assert (state.events, state.is_engaged) == ((), True)
        assert state.qd[0] == pytest.approx(SPEED_RADPS)


@pytest.mark.parametrize("kind", ["joints", "line", "stop"])
@pytest.mark.parametrize("failing", [1, 3, 20])
def test_a_move_and_its_stop_leave_in_the_end_though_their_sending_failed(kind: str, failing: int) -> None:
    with arm(q_start=(0.3, 0.5, 0.1, 1.0, 0.2, 0.8, 0.1)) as bridge:
        begin = bridge.get_state()
        assert bridge.simulator is not None
        if kind == "stop":
            bridge.move_j(begin.q + ONE_JOINT, speed_radps=0.3)
            moving = bridge.step(100)
        bridge.simulator.fail_sends(failing)
        if kind == "joints":
            bridge.move_j(begin.q + 0.05 * ONE_JOINT, speed_radps=0.3)
        elif kind == "line":
            bridge.move_l(begin.tcp_pose + np.array([0.01, 0, 0, 0, 0, 0]), speed_mps=0.05)
        else:
            bridge.hold()
        state = bridge.step(failing + 100)
        assert (state.failed_sends, state.move_sends) == (failing, 2 if kind == "stop" else 1)
        assert (state.is_moving, state.mode, state.events) == (False, "idle", ())
        if kind == "joints":
            assert state.q[0] == pytest.approx(begin.q[0] + 0.05, abs=1e-9)
        elif kind == "line":
            assert state.tcp_pose[0] == pytest.approx(begin.tcp_pose[0] + 0.01, abs=1e-6)
        else:
            assert moving.q[0] < state.q[0] < moving.q[0] + 0.3 * 1.9 * (0.004 * failing + 0.1)
            assert np.all(bridge.trace(failing + 100)["qd"][:, 0] >= -1e-9), "it does not go back"
