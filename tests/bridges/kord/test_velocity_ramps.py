"""Velocities of which a command is missing, while they grow, turn, fall, or a range ends: none is a jump."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from station_kord import KordBridge, OutOfLimits, State

from adapters.robots.arm_limits import load
from tests.bridges.kord.arms import LIMITS, ONE_JOINT, arm, ids
from tests.examples import some

_SHIPPED = load("kassow", "kr810")
FAST = dataclasses.replace(LIMITS, qd_max=tuple(_SHIPPED.qd_max), qdd_max=tuple(_SHIPPED.qdd_max))
"""Those that ship: here a speed may change as fast as the controller takes it."""

LONG = 60  # ticks until 2.6 rad/s are reached
FASTEST_RADPS = 2.66


def _miss(bridge: KordBridge, how: str) -> None:
    """Let a command be missing: one that cannot leave, is never made, or is lost on its way."""
    assert bridge.simulator is not None
    if how == "failed send":
        bridge.simulator.fail_sends(1)
    elif how == "lost frame":
        bridge.simulator.lose_commands(1)
    else:
        bridge.simulator.silence(True)
        bridge.step(1)
        bridge.simulator.silence(False)


def _course(bridge: KordBridge, speed_radps: float, then: str, missing: int, how: str) -> State:
    """Drive joint 1 at a speed, then as told, without the command of one tick."""
    for tick in range(LONG + 70):
        if tick < LONG or then in ("zero", "turn"):
            now_radps = speed_radps if tick < LONG else {"zero": 0.0, "turn": -speed_radps}[then]
            bridge.velocity_j(now_radps * ONE_JOINT)
        elif tick == LONG and then == "hold":
            bridge.hold()
        if tick == missing:
            _miss(bridge, how)
        state = bridge.step(1)
        if state.is_faulted:
            break
    return state


@pytest.mark.parametrize("then", ["cease", "hold", "zero", "turn"])
@pytest.mark.parametrize("how", ["failed send", "missed heartbeat"])
@pytest.mark.parametrize("speed_radps", [0.3, 2.0, 2.6])
def test_one_command_that_did_not_leave_is_no_torque_deviation(speed_radps: float, how: str, then: str) -> None:
    for missing in some([*range(1, LONG, 7), *range(LONG, LONG + 70, 2), LONG + 23, LONG + 25]):
        with arm(limits=FAST) as bridge:
            state = _course(bridge, speed_radps, then, missing, how)
            assert ids(state) == [], f"missing in tick {missing}"
            if then != "turn":
                assert not state.qd.any()


@pytest.mark.parametrize("speed_radps", [0.3, 2.0, 2.6])
def test_one_command_that_is_lost_unseen_while_a_speed_grows_is_no_torque_deviation(speed_radps: float) -> None:
    for missing in some(range(1, LONG, 3)):
        with arm(limits=FAST) as bridge:
            assert ids(_course(bridge, speed_radps, "cease", missing, "lost frame")) == [], f"missing in tick {missing}"


@pytest.mark.parametrize("how", ["failed send", "missed heartbeat", "lost frame"])
def test_a_range_ends_without_a_fault_though_a_command_is_missing_before_it(how: str) -> None:
    begin = (LIMITS.q_max[0] - 0.15, *(0.0,) * 6)
    for missing in some(range(60, 125, 2)):
        with arm(limits=FAST, q_start=begin) as bridge:
            for tick in range(160):
                bridge.velocity_j(0.5 * ONE_JOINT)
                if tick == missing:
                    _miss(bridge, how)
                state = bridge.step(1)
            assert ids(state) == [], f"missing in tick {missing}"
            assert state.q[0] == pytest.approx(LIMITS.q_max[0], abs=1e-3)


@pytest.mark.parametrize("mode", ["velocity", "direct"])
def test_the_fastest_velocity_comes_to_rest_in_time_when_it_ceases(mode: str) -> None:
    with arm(limits=FAST) as bridge:
        q, speed = bridge.get_state().q, 0.0
        if mode == "direct":
            bridge.direct_j(q)
            bridge.step(1)
        for _ in range(80):
            speed = min(FASTEST_RADPS, speed + 0.04)
            q[0] += speed * 0.004
            if mode == "direct":
                bridge.direct_j(q, speed * ONE_JOINT)
            else:
                bridge.velocity_j(FASTEST_RADPS * ONE_JOINT)
            bridge.step(1)
        assert bridge.get_state().qd[0] == pytest.approx(FASTEST_RADPS)
        state = bridge.step(26)
        assert (ids(state), state.qd[0]) == ([], 0.0)
        assert np.abs(np.diff(bridge.trace(30)["qd"][:, 0])).max() <= 0.14 + 1e-9


@pytest.mark.parametrize("speed_radps", [2.67, -3.5])
def test_a_velocity_that_could_not_end_in_time_is_refused(speed_radps: float) -> None:
    message = rf"joint 1 at {speed_radps:g} rad/s is faster than 2\.66 rad/s, .* rest within 100 ms"
    with arm(limits=FAST) as bridge:
        with pytest.raises(OutOfLimits, match=f"velocity_j: {message}"):
            bridge.velocity_j(speed_radps * ONE_JOINT)
        with pytest.raises(OutOfLimits, match=f"direct_j: {message}"):
            bridge.direct_j(np.zeros(7), speed_radps * ONE_JOINT)
        assert bridge.step(5).direct_sends == 0
