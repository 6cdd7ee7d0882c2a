"""That an arm which was told to stop does stop: by measured speeds that are not exact, and by frames that are lost."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from station_kord import KordBridge, State

from tests.bridges.kord.arms import ONE_JOINT, SPEED_RADPS, arm, stream

LINE_FROM = (0.3, 0.5, 0.1, 1.0, 0.2, 0.8, 0.1)
SEEDS = 40


def _end(bridge: KordBridge, end: str) -> None:
    getattr(bridge, end)()


def _truth(bridge: KordBridge, ticks: int) -> Any:
    assert bridge.simulator is not None
    return bridge.simulator.trace(ticks)


def _furthest(bridge: KordBridge, ticks: int) -> float:
    """Return how far joint 1 has come in the last ticks [rad]."""
    return float(_truth(bridge, ticks)["q"][:, 0].max())


@pytest.mark.parametrize("end", ["hold", "disengage", "close"])
@pytest.mark.parametrize("noise_radps", [0.0005, 0.0002])
@pytest.mark.parametrize("speed_radps", [0.05, 0.1, 0.3])
def test_a_move_that_begins_gently_is_ended_whatever_noise_is_in_what_is_seen_of_it(
    speed_radps: float, noise_radps: float, end: str
) -> None:
    for seed in range(SEEDS):
        with arm(opaque=True, speed_noise_radps=noise_radps, noise_seed=seed) as bridge:
            bridge.move_j(ONE_JOINT, speed_radps=speed_radps)
            before = bridge.step(150)
            assert before.mode == "move-joints", f"seed {seed}"
            _end(bridge, end)
            if end == "close":
                bridge.connect()
            state = bridge.step(100)
            assert (state.move_sends, state.mode) == (2, "idle"), f"seed {seed}"
            assert _furthest(bridge, 100) < before.q[0] + speed_radps * 0.1, f"seed {seed}"
            assert not _truth(bridge, 50)["qd"].any()


@pytest.mark.parametrize("end", ["hold", "disengage"])
@pytest.mark.parametrize("way", [(0.1, -0.1, 0.1, 0, 0, 0), (0.1, 0, 0, 0.3, -0.2, 0.4)], ids=["straight", "turning"])
def test_a_line_that_begins_gently_is_ended_whatever_noise_is_in_what_is_seen_of_it(
    way: tuple[float, ...], end: str
) -> None:
    for seed in range(SEEDS // 2):
        with arm(opaque=True, speed_noise_radps=0.0005, noise_seed=seed, q_start=LINE_FROM) as bridge:
            goal = bridge.get_state().tcp_pose + np.array(way)
            bridge.move_l(goal, speed_mps=0.02)
            before = bridge.step(40 + 3 * seed)  # seen in some ticks, and later in all
            assert before.mode == "move-line", f"seed {seed}"
            _end(bridge, end)
            state = bridge.step(100)
            assert (state.move_sends, state.mode) == (2, "idle"), f"seed {seed}"
            assert np.abs(state.q - before.q).max() < 0.01
            assert not _truth(bridge, 50)["qd"].any()


@pytest.mark.parametrize("noise_radps", [0.0, 0.0005])
def test_a_move_that_is_let_go_on_is_over_where_it_leads(noise_radps: float) -> None:
    with arm(opaque=True, speed_noise_radps=noise_radps, q_start=LINE_FROM) as bridge:
        begin = bridge.get_state()
        bridge.move_j(begin.q + 0.05 * ONE_JOINT, speed_radps=0.1)
        assert bridge.step(80).mode == "move-joints"
        state = bridge.step(80)
        assert (state.mode, state.is_moving) == ("idle", False)
        assert state.q[0] == pytest.approx(begin.q[0] + 0.05, abs=1e-9)
        bridge.move_l(begin.tcp_pose, speed_mps=0.1)
        state = bridge.step(200)
        assert (state.mode, state.is_moving, state.move_sends) == ("idle", False, 2)
        assert state.tcp_pose == pytest.approx(begin.tcp_pose, abs=1e-6)


def _respelled(pose: Any) -> Any:
    """Return the same pose by the other roll, pitch and yaw that there are of every rotation."""
    return pose + np.array([0, 0, 0, np.pi, np.pi - 2 * pose[4], -np.pi])


@pytest.mark.parametrize("opaque", [False, True])
@pytest.mark.parametrize("way_m", [0.0, 0.02])
def test_a_line_ends_though_its_goal_is_spelled_otherwise_than_where_the_tool_is(way_m: float, opaque: bool) -> None:
    with arm(opaque=opaque, q_start=LINE_FROM) as bridge:
        goal = _respelled(bridge.get_state().tcp_pose) + np.array([way_m, 0, 0, 0, 0, 0])
        bridge.move_l(goal, speed_mps=0.05)
        state = bridge.step(300)
        assert (state.mode, state.is_moving, state.move_sends) == ("idle", False, 1)
        bridge.disengage()
        bridge.step(1)
        bridge.engage()


@pytest.mark.parametrize("queues", [False, True])
@pytest.mark.parametrize("end", ["hold", "disengage", "close"])
def test_a_stream_of_stop_points_is_not_ended_by_one_more_of_them(end: str, queues: bool) -> None:
    with arm("legacy-stop", queues_after_stop_point=queues) as bridge:
        moving = stream(bridge, 100, every=2)
        _end(bridge, end)
        if end == "close":
            bridge.connect()
        state = bridge.step(27_000 if not queues or end == "hold" else 100)
        assert state.move_sends == moving.move_sends == 0
        if state.tick > 20_000:
            rows = _truth(bridge, 14_000)
            assert rows["qd"].min() >= -1e-9, "it does not jump back"
            assert (state.is_moving, state.events) == (False, ())
            assert state.q[0] == pytest.approx(0.12, abs=1e-9)


@pytest.mark.parametrize("opaque", [False, True])
@pytest.mark.parametrize("kind", ["joints", "line", "far"])
@pytest.mark.parametrize("end", ["hold", "disengage", "close"])
@pytest.mark.parametrize("lost", [1, 2])
def test_a_stop_whose_frame_is_lost_is_sent_again(lost: int, end: str, kind: str, opaque: bool) -> None:
    with arm(opaque=opaque, q_start=LINE_FROM) as bridge:
        begin = bridge.get_state()
        if kind == "joints":
            bridge.move_j(begin.q + ONE_JOINT, speed_radps=SPEED_RADPS)
        elif kind == "line":
            bridge.move_l(begin.tcp_pose + np.array([0.15, -0.15, 0.15, 0, 0, 0]), speed_mps=0.05)
        else:
            bridge.stream_j(begin.q + ONE_JOINT)
        before = bridge.step(250)
        assert bridge.simulator is not None
        bridge.simulator.lose_commands(lost)
        _end(bridge, end)
        if end == "close":
            bridge.connect()
        state = bridge.step(150)
        assert (state.is_moving, state.mode, state.events) == (False, "idle", ())
        assert not _truth(bridge, 20)["qd"].any()
        assert state.move_sends == before.move_sends + 1 + lost
        speed = np.abs(before.qd).max() * 1.9
        assert np.abs(state.q - before.q).max() < speed * (0.1 + lost * 0.2)


@pytest.mark.parametrize("end", ["hold", "disengage"])
@pytest.mark.parametrize("ticks", [1, 10, 40, 80])
@pytest.mark.parametrize("noise_radps", [0.0, 0.0005])
def test_a_move_that_was_not_seen_when_its_stop_was_lost_is_stopped_once_it_is_seen(
    noise_radps: float, ticks: int, end: str
) -> None:
    with arm(opaque=True, speed_noise_radps=noise_radps) as bridge:
        bridge.move_j(ONE_JOINT, speed_radps=0.05)
        bridge.step(ticks)
        assert bridge.simulator is not None
        bridge.simulator.lose_commands(1)
        _end(bridge, end)
        state = bridge.step(400)
        assert (state.is_moving, state.mode, state.events) == (False, "idle", ())
        assert state.q[0] < 0.01
        assert not _truth(bridge, 50)["qd"].any()
        sends = state.move_sends
        assert bridge.step(500).move_sends == sends <= 4


def test_a_stop_that_does_nothing_is_sent_a_few_times_and_again_for_who_holds_again() -> None:
    with arm() as bridge:
        bridge.move_j(3.0 * ONE_JOINT, speed_radps=0.2)
        bridge.step(250)
        assert bridge.simulator is not None
        bridge.simulator.lose_commands(4)
        bridge.hold()
        state = bridge.step(500)
        assert (state.move_sends, state.is_moving, state.mode) == (1 + 4, True, "move-joints")
        bridge.hold()
        state = bridge.step(60)
        assert (state.move_sends, state.is_moving, state.mode) == (1 + 5, False, "idle")
        assert not _truth(bridge, 20)["qd"].any()


def _until_it_stands(bridge: KordBridge) -> State:
    state = bridge.get_state()
    for _ in range(400):
        state = bridge.step(10)
        if not state.is_moving:
            break
    return state


@pytest.mark.parametrize("opaque", [False, True])
def test_a_controller_that_finishes_a_move_first_goes_back_and_is_under_way_until_then(opaque: bool) -> None:
    """What `hold` warns of: no stop by a target can do better there, and nobody drives the arm in the meantime."""
    with arm(opaque=opaque, queues_after_stop_point=True) as bridge:
        bridge.move_j(0.1 * ONE_JOINT, speed_radps=0.1)
        held = bridge.step(125)
        bridge.disengage()
        assert bridge.step(100).is_moving
        state = _until_it_stands(bridge)
        assert (state.mode, state.events) == ("idle", ())
        rows = _truth(bridge, state.tick)
        assert rows["q"][:, 0].max() == pytest.approx(0.1, abs=1e-6)
        assert held.q[0] < state.q[0] < 0.1
        assert state.move_sends <= 1 + 4
        bridge.engage()
