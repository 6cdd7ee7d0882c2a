"""Contracts of an arm behind a controller of its own; arms of a family differ in their limits, not in these."""

from __future__ import annotations

from station.bus import joints, keys
from station.bus.contract import POSE, TIMING_STAGES, Codec, Contract, Role
from station.elements import Element, elements, positions, velocities

COUNTERS = (
    "tick", "stream_j_sends", "direct_sends", "move_sends", "commands_dropped_by_throttle", "slewed_sends",
    "limit_refusals", "sync_timeouts", "missed_ticks", "late_commands", "fault_count",
)  # fmt: skip
"""First elements of `keys.state_counters`: `tick` counts the controller's heartbeats (250 Hz), `stream_j_sends` the
targets that were sent to it."""

SESSION_TIMES = (
    "sync_to_send_last", "sync_to_send_p50", "sync_to_send_p99", "sync_to_send_max",
    "period_p50", "period_p99", "period_max", "queued_motion",
)  # fmt: skip
"""The rest of them: from a heartbeat to the sending of a command; between two heartbeats; and how much motion the
controller still owes, NaN where it does not tell."""


def of(robot: str) -> list[Contract]:
    """Contracts of an arm behind a controller of its own; the command is what moves, everything else tells."""
    names = joints.ARM_7
    q = elements((positions(names), "rad"))
    counted = elements((COUNTERS, ""), (SESSION_TIMES, "s"))

    def make(key: str, role: Role, codec: Codec, items: tuple[Element, ...] = (), note: str = "",
             rate_hz: float | None = 250.0) -> Contract:  # fmt: skip
        return Contract(key=key, family="station", role=role, codec=codec, elements=items, rate_hz=rate_hz, note=note)

    return [
        make(keys.action_joints(robot), "command", "json-vector", q,
             "absolute, never wrapped; written in each tick of who commands, and sent on only where it moved"),
        make(keys.state_joints(robot), "state", "f64",
             (*q, *elements((velocities(names), "rad/s"), (tuple(f"{name}_torque" for name in names), "N m"))),
             "as the controller reports them: its model's where it tells no sensor's, which hides tracking errors",
             rate_hz=125.0),
        make(keys.state_tcp(robot), "state", "f64", POSE, "frame of the arm's base", rate_hz=125.0),
        make(keys.state_counters(robot), "state", "f64", counted, "counters only grow; rates are for who reads",
             rate_hz=125.0),
        make(keys.state_controller(robot), "state", "json", rate_hz=None,
             note="ten times a second: backend, profile, throttle, flags, alarm and newest event of the controller"),
        make(keys.target(robot), "policy", "f64", q, "newest target handed to the controller's session; the "
             "controller is sent those that moved"),
        make(keys.command_gate(robot), "policy", "json", note="state, reason and age of the command at the gate"),
        make(keys.command_used(robot), "policy", "f64", q, "the command after the gate; where nobody is followed, "
             "where the arm is"),
        make(keys.policy_timing(robot), "policy", "json-vector",
             elements((("tick", "command_seq"), ""), (TIMING_STAGES, "ns")),
             "one machine's monotonic clock; no policy: observed and inferred are when the gate had decided"),
        make(keys.command_source(robot), "command", "json", note="device, driver and sample of the command",
             rate_hz=None),
    ]  # fmt: skip
