"""Arms for the tests: a simulated controller on a virtual clock, and hands that drive it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from station_kord import KordBridge, Limits, Profile, SimOptions, State

SPEED_RADPS = 0.3
TICK_S = 0.004
STEP_RAD = SPEED_RADPS * TICK_S
ONE_JOINT = np.array([1.0, 0, 0, 0, 0, 0, 0])

LIMITS = Limits(
    q_min=SimOptions().q_min, q_max=SimOptions().q_max, qd_max=(2.0,) * 7, qdd_max=(10.0,) * 7
)  # fmt: skip


PATIENT = SimOptions(late_fault_ticks=1_000_000, watchdog_ticks=1_000_000, torque_deviation_rad=1.0)
"""A controller on the wall clock that does not mind what a busy machine does to the bridge."""


@contextlib.contextmanager
def arm(profile: str | Profile = "speed125", *, limits: Limits = LIMITS, **sim: Any) -> Iterator[KordBridge]:
    """Yield a connected and engaged arm on a virtual clock; `sim` are fields of `SimOptions`."""
    options = SimOptions(clock="virtual", **sim)
    with KordBridge(limits=limits, profile=profile, sim=options, real_time_priority=0, trace_ticks=30_000) as bridge:
        bridge.connect()
        bridge.engage()
        yield bridge


def stream(
    bridge: KordBridge, ticks: int, *, speed_radps: float = SPEED_RADPS, every: int = 1,
    until: Callable[[State], bool] = lambda state: False,
) -> State:  # fmt: skip
    """Let the target of joint 1 run for so many ticks, written on every so-manieth, as a held key does."""
    q = bridge.get_state().q_target.copy()
    for tick in range(ticks):
        if tick % every == 0:
            q[0] += speed_radps * TICK_S * every
            bridge.stream_j(q)
        if until(bridge.step(1)):
            break
    return bridge.get_state()


def direct(bridge: KordBridge, ticks: int, speed_radps: float) -> State:
    """Drive joint 1 by direct commands up to a speed, as fast as the limits allow, and on at that speed."""
    q, speed = bridge.get_state().q.copy(), 0.0
    bridge.direct_j(q)
    bridge.step(1)
    for _ in range(ticks):
        speed = min(speed_radps, speed + LIMITS.qdd_max[0] * TICK_S)
        q[0] += speed * TICK_S
        bridge.direct_j(q, speed * ONE_JOINT)
        state = bridge.step(1)
        if state.is_faulted:
            return state
    return bridge.get_state()


def drive(bridge: KordBridge, mode: str, ticks: int) -> State:
    """Have joint 1 moved for so many ticks: by a stream, a velocity, direct commands, or a move of the controller's."""
    if mode == "stream":
        return stream(bridge, ticks)
    if mode == "direct":
        return direct(bridge, ticks, SPEED_RADPS)
    if mode == "move":
        bridge.move_j(ONE_JOINT, speed_radps=SPEED_RADPS)
        return bridge.step(ticks)
    for _ in range(ticks):
        bridge.velocity_j(SPEED_RADPS * ONE_JOINT)
        bridge.step(1)
    return bridge.get_state()


def ids(state: State) -> list[int]:
    """Return the conditions of the events so far."""
    return [event.id for event in state.events]
