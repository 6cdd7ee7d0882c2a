"""What a session tells: one snapshot per tick of the controller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Mode = Literal["idle", "stream", "velocity", "direct", "move-joints", "move-line"]

TRACE = np.dtype(
    [
        ("tick", "<i8"),
        ("q", "<f8", 7),
        ("qd", "<f8", 7),
        ("q_target", "<f8", 7),
        ("q_sent", "<f8", 7),
        ("queued_motion_s", "<f8"),
        ("planner_backlog", "<i4"),
        ("sent", "u1"),
        ("late", "u1"),
        ("moving", "u1"),
        ("fault", "u1"),
    ]
)
"""One row per tick of `KordBridge.trace`.

- `q`, `qd`: reference of the controller [rad], [rad/s];
- `q_target`: what was asked for; `q_sent`: what was sent last [rad];
- `queued_motion_s`: motion that the controller still owes [s]; NaN where it does not tell;
- `planner_backlog`: moves that wait to be planned; -1 where the controller does not tell;
- `sent`: whether a command was sent in this tick; `late`: whether one was found to have come too late since the row
  before;
- `moving`, `fault`: 0 or 1.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """How long something has taken since the session's first tick [µs].

    Percentiles are brought up to date five times a second.
    """

    last: float
    p50: float
    p99: float
    max: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """A fault, or another event that the controller told.

    Attributes:
        number: Counts the session's events from 1; survives reconnecting.
        id: Condition, such as 1010, 2005, 3001, 3002; 0 where the controller named none.
        group: ``safety``, ``soft-stop``, ``hardware``, ``kord`` or ``connection``.
        text: One line for the operator.
        tick: Tick of the session in which it was seen.
        mono_ns: CLOCK_MONOTONIC of that tick [ns].
    """

    number: int
    id: int
    group: str
    text: str
    tick: int
    mono_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """One snapshot; all of it is of the same tick. Counters only grow, and survive reconnecting.

    Rates are made by the reader: difference of a counter over difference of `mono_ns`.

    Attributes:
        backend: ``sim`` or ``kord``.
        mode: What the arm is being asked for.
        profile, throttle: Of the stream.
        is_connected: There is a session and heartbeats arrive.
        is_engaged: Commands are taken; see `KordBridge.engage`. A fault, a lost session and a controller that is not
            ready end it.
        is_faulted: The controller is in an alarm, suspended or halted, or the session was lost by a fault.
        is_moving: The controller's reference moves, motion is queued, or a `move_j` or `move_l` that was sent has not
            been seen to end. One that the controller never began is ended by `KordBridge.hold`.
        not_ready: Why the controller takes no commands though nothing is wrong, such as ``paused`` or ``offline``; ""
            where it does. It ends an engagement as a fault does.
        needs_user_confirmation: Only a person at the controller can clear what is wrong.
        mono_ns: CLOCK_MONOTONIC of the tick's heartbeat [ns]; with a virtual clock its own time.
        session_age_s: Since the session was opened [s].
        q, qd, qdd: Joint positions [rad], velocities [rad/s], accelerations [rad/s²], shape (7,). They are the
            controller's reference and not sensors, so they hide tracking errors.
        torque: Shape (7,) [N·m].
        tcp_pose: Position [m] and roll, pitch, yaw [rad] of the tool in the base frame, shape (6,).
        q_target: What was asked for last, shape (7,) [rad]; after engaging, the joints at that moment.
        q_sent: What was sent last in this session, shape (7,) [rad]; before, the joints at its beginning.
        queued_motion_s: Motion that the controller still owes [s]; NaN where it does not tell.
        planner_backlog: Moves that wait to be planned; -1 where the controller does not tell.
        tick: Heartbeats that waitSync returned: 250 Hz.
        stream_j_sends: moveJ of the stream that were sent: 125 Hz in motion with a throttle of 2, 0 Hz at hold.
        direct_sends: Direct joint commands that were sent (`velocity_j`, `direct_j`).
        move_sends: One-shot moves that were sent, and their stops.
        failed_sends: Commands that did not leave this machine; targets of a stream, moves, and the last of a velocity
            or direct motion are sent again.
        commands_dropped_by_throttle: Targets of the stream that a newer one replaced before their turn.
        slewed_sends: Targets of the stream that were approached in steps, see `Profile.offset_guard`.
        limit_refusals: Commands that the last check in C++ did not send or cut at a limit, and motions that it cut off.
        sync_timeouts: waitSync calls without a heartbeat.
        missed_ticks: Heartbeats that passed while the loop was late.
        late_commands: Commands that came after their window, as far as this side or the simulator can tell.
        fault_count: Faults so far.
        trace_skipped: Rows that the trace lacks because it was being read.
        sync_to_send_us: From the return of waitSync until a command was handed over.
        period_us: Between two heartbeats.
        sched_fifo_granted, memory_locked: What the system permitted; see `KordBridge.real_time`.
        motion_flags, safety_flags, alarm_state: The controller's own words, bit by bit.
        safety_mode: 1 normal, 2 reduced, 3 safe.
        master_speed: Of the controller, 0 to 1.
        events: The last ones, oldest first, eight at most.
    """

    backend: str
    mode: Mode
    profile: str
    throttle: int
    is_connected: bool
    is_engaged: bool
    is_faulted: bool
    is_moving: bool
    not_ready: str
    needs_user_confirmation: bool
    mono_ns: int
    session_age_s: float
    q: Floats
    qd: Floats
    qdd: Floats
    torque: Floats
    tcp_pose: Floats
    q_target: Floats
    q_sent: Floats
    queued_motion_s: float
    planner_backlog: int
    tick: int
    stream_j_sends: int
    direct_sends: int
    move_sends: int
    failed_sends: int
    commands_dropped_by_throttle: int
    slewed_sends: int
    limit_refusals: int
    sync_timeouts: int
    missed_ticks: int
    late_commands: int
    fault_count: int
    trace_skipped: int
    sync_to_send_us: Timing
    period_us: Timing
    sched_fifo_granted: bool
    memory_locked: bool
    motion_flags: int
    safety_flags: int
    safety_mode: int
    master_speed: float
    alarm_state: int
    events: tuple[Event, ...]

    @property
    def last_event(self) -> Event | None:
        """The newest event, or None."""
        return self.events[-1] if self.events else None
