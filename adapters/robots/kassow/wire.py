"""What the server of a Kassow arm puts on the bus of its controller's state."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from adapters.robots.kassow import kinematics
from station import rotations
from station.bus import codec, keys
from station.bus.robot_streams import COUNTERS
from station.protocols import Floats

if TYPE_CHECKING:
    from station_kord import State

_MICRO = 1e-6


def state_values(robot: str, state: State, tool: Callable[[Floats], Floats] | None) -> dict[str, bytes]:
    """Return joints, tool and counters by key.

    Args:
        robot: Suffix of its keys.
        state: Newest state of the session.
        tool: Makes the tool's pose of joints where the controller does not know it (a simulated one).
    """
    pose = tcp_pose(state.tcp_pose) if tool is None else tool(state.q)
    return {
        keys.state_joints(robot): codec.f64(np.concatenate([state.q, state.qd, state.torque])),
        keys.state_tcp(robot): codec.f64(pose),
        keys.state_counters(robot): codec.f64(counters(state)),
    }


def tool_of(model: str) -> Callable[[Floats], Floats] | None:
    """Return what makes a tool's pose of joints, for a model whose kinematics are known."""
    chain = kinematics.MODELS.get(model)
    if chain is None:
        return None

    def tool(q: Floats) -> Floats:
        pose = chain.posture(q).pose
        return np.concatenate([pose.position, pose.quat_wxyz])

    return tool


def tcp_pose(xyz_rpy: Floats) -> Floats:
    """Return position [m] and quaternion wxyz of a pose with roll, pitch, yaw [rad], shape (7,).

    The angles turn about the base's x, y and z, in this order.
    """
    about = [rotations.from_rotation_vector(angle * axis) for angle, axis in zip(xyz_rpy[3:], np.eye(3), strict=True)]
    return np.concatenate([xyz_rpy[:3], rotations.multiply(about[2], rotations.multiply(about[1], about[0]))])


def counters(state: State) -> list[float]:
    """Return the counters and times of a state, in the order of their contract; times in [s]."""
    sync, period = state.sync_to_send_us, state.period_us
    micros = (sync.last, sync.p50, sync.p99, sync.max, period.p50, period.p99, period.max)
    counted = (float(getattr(state, name)) for name in COUNTERS)
    return [*counted, *(value * _MICRO for value in micros), state.queued_motion_s]


def controller(state: State, lead_rad: float) -> dict[str, Any]:
    """Return what the controller says of itself, and how far ahead of the arm targets may be [rad]."""
    event = state.last_event
    return {
        "backend": state.backend,
        "mode": state.mode,
        "profile": state.profile,
        "throttle": state.throttle,
        "lead_rad": lead_rad,
        "connected": state.is_connected,
        "engaged": state.is_engaged,
        "faulted": state.is_faulted,
        "moving": state.is_moving,
        "not_ready": state.not_ready,
        "needs_confirmation": state.needs_user_confirmation,
        "motion_flags": state.motion_flags,
        "safety_flags": state.safety_flags,
        "safety_mode": state.safety_mode,
        "alarm_state": state.alarm_state,
        "master_speed": state.master_speed if math.isfinite(state.master_speed) else None,
        "planner_backlog": state.planner_backlog,
        "sched_fifo_granted": state.sched_fifo_granted,
        "memory_locked": state.memory_locked,
        "session_age_s": round(state.session_age_s, 3),
        "last_event": None if event is None else {"id": event.id, "group": event.group, "text": event.text},
    }
