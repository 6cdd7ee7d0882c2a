"""One tick of an arm: state, command, gate, target, session. Protocols only: no bus, and no clock that decides.

A target is handed to the session only where it moved, and never farther ahead of the arm than it may still go when
everything here is gone (`ArmSession.lead_rad`). Whatever ends following (silence, a stop, a fault, disarming) releases
the session at once; it is engaged anew, from where the joints are then, with the next command that begins. After all of
these but silence, after an obstacle, and after a session that refused or took no more targets by itself, commands have
to cease first: nothing begins to move because a reason went away.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from station.arms import ArmSession, ArmState
from station.bus import codec, keys
from station.clock import SYSTEM, Clock
from station.control.arming import Arming
from station.control.command_path import CommandPath, StepEvent
from station.control.command_validator import Samples
from station.control.gate import FOLLOWING, MOVING, Decision, GateConfig
from station.life.arm_request import ArmAnswer
from station.life.controller_request import ControllerAnswer
from station.protocols import CommandFormat, Floats

_DISARMED = "the arm was disarmed"
_MOST_TEXTS = 16  # of one fault are told, should a controller put a number into them that runs


def aim(wanted: Floats, q: Floats, lead_rad: float) -> Floats:
    """Return the target of an arm whose joints are at `q`, shapes (n,) [rad]: no farther ahead than its lead."""
    target: Floats = np.clip(wanted, q - lead_rad, q + lead_rad)
    return target


@dataclass(frozen=True, slots=True, eq=False)
class ArmRecord:
    """Everything that a tick did.

    Attributes:
        tick: Number of the tick, from 1.
        state: What the session told.
        decision: What the gate let through.
        target: The newest target that the session took, shape (n,) [rad]; where no command is followed, the joints.
        is_sent: Whether it was handed over in this tick.
        refusal: Why the session was not engaged in this tick, or did not take the target that it was handed, or "".
        command_seq: Sequence number of the command that was used; 0 when foreign or none.
        timing_ns: The six instants of `station.contract.TIMING_STAGES`; 0 where unknown. Without a policy the
            third and fourth are the instant that the gate was given.
        step_events: What happened, in order.
    """

    tick: int
    state: ArmState
    decision: Decision
    target: Floats
    is_sent: bool
    refusal: str
    command_seq: int
    timing_ns: tuple[int, int, int, int, int, int]
    step_events: tuple[StepEvent, ...]


class ArmControl:
    """An arm's session and the gate between it and the command (`station.control.command_path.Control`).

    Args:
        session: With the arm's controller.
        command_format: Format of the command.
        gate: Times of the gate.
        is_armed: Whether targets are handed over from the start; False for real arms.
        clock: Says when a target was handed over.

    Attributes:
        commanded: Validator, gate and arming.
    """

    def __init__(
        self,
        session: ArmSession,
        command_format: CommandFormat,
        *,
        gate: GateConfig,
        is_armed: bool,
        clock: Clock = SYSTEM,
    ) -> None:
        self.session, self._clock = session, clock
        self.commanded = CommandPath(command_format, gate, Arming(is_armed=is_armed, ramp_s=0.0))
        self._target: Floats | None = None  # newest target that was taken; None: not engaged
        self._refusal = ""  # of this tick
        self._was_refused = False  # whether it took none when it was last handed one
        self._faults_told: set[str] = set()  # texts of the present fault
        self._tick = 0

    def sense(self) -> ArmState:
        """Return the state that the next `step` acts on."""
        return self.session.read()

    def step(self, state: ArmState, sample: Samples, now_s: float) -> ArmRecord:
        """Act on a state and the newest command sample.

        Args:
            state: From `sense`.
            sample: The newest write of the command key, good or bad; the same object as long as nothing new came.
            now_s: The instant, on the clock of `CommandSample.arrived_s` [s].
        """
        self._tick += 1
        now_ns = round(now_s * 1e9)  # so that an audit can give the gate the very same instant
        gate = self.commanded.gate
        gate.rest(state.q)
        self._see_to_fault(state)
        self._see_to_engagement(state)
        self._see_to_readiness(state, now_s)
        decision = self.commanded.decide(sample, now_ns * 1e-9, why_blocked=self._why_blocked(state))
        sent_ns, self._refusal = 0, ""
        if decision.state not in FOLLOWING:
            self._release()
        elif decision.state in MOVING:
            sent_ns = self._clock.monotonic_ns() if self._send(decision.vector, state) else 0
        good = self.commanded.validator.good
        stages = (good.written_ns if good else 0, good.arrived_ns if good else 0, state.mono_ns)
        return ArmRecord(
            tick=self._tick,
            state=state,
            decision=decision,
            target=state.q if self._target is None else self._target,
            is_sent=sent_ns > 0,
            refusal=self._refusal,
            command_seq=good.seq if good else 0,
            timing_ns=(*stages, now_ns, now_ns, sent_ns),
            step_events=self.commanded.taken(),
        )

    def stop(self, reason: str) -> None:
        """Latch the emergency stop: the session takes no more targets, at once."""
        self.commanded.stop(reason)
        self._release()

    def reset(self, reason: str) -> None:
        """Leave the emergency stop; a simulated arm may be moved again, a real one needs arming."""
        if self.commanded.gate.state == "stopped":
            self.commanded.gate.reset(reason)
            self.commanded.add_event("operator-reset", "warning", reason=reason)
            if self.session.is_simulated:
                self.commanded.arming.restart()
            else:
                self.commanded.arming.disarm()

    def clearing(self) -> None:
        """End driving while faults are cleared, there being one or not: that ends the session's engagement."""
        if self._target is not None:
            self._end("the controller's faults are being cleared")

    def cleared(self, who: str) -> None:
        """Leave a fault that the controller has no more; commands have to begin anew."""
        if self.commanded.gate.state == "faulted":
            self.commanded.gate.reset("the controller's faults are cleared")
        self.commanded.add_event("controller-cleared", "warning", who=who)

    def arm(self, now_s: float, who: str = "") -> str:
        """Let targets go to the session; return why not, or ""."""
        gate = self.commanded.gate
        refusal = ""
        if gate.state == "stopped":
            refusal = f"the emergency stop is latched ({gate.reason}); release it first: station estop --reset"
        elif gate.state == "faulted":
            refusal = f"the controller is faulted: {gate.reason}"
        return self.commanded.arm(now_s, who, refusal)

    def disarm(self, who: str = "") -> None:
        """Send no targets to the session, at once; the commander has to let go, even if it is armed again at once."""
        self.commanded.disarm(who)
        self._release()
        self.commanded.gate.insist_on_silence(_DISARMED)

    def health(self) -> dict[str, Any]:
        """Return what a server's heartbeat tells of this arm."""
        return self.session.health()

    def _see_to_fault(self, state: ArmState) -> None:
        """Hold the arm while its controller has a fault; publish each text of it once: it says what to do."""
        gate = self.commanded.gate
        if not state.fault or gate.state == "stopped":
            return
        if gate.state != "faulted":
            self._release()
            self._faults_told.clear()
        gate.fault(state.fault)
        if state.fault not in self._faults_told and len(self._faults_told) < _MOST_TEXTS:
            self._faults_told.add(state.fault)
            self.commanded.add_event("controller-fault", "error", reason=state.fault)

    def _see_to_readiness(self, state: ArmState, now_s: float) -> None:
        """Let arming go on; a command that runs meanwhile is not followed once the arm may move."""
        arming = self.commanded.arming
        if arming.state == "arming" and arming.stiffen(now_s) == 1.0:
            self.commanded.add_event("armed", "warning")
        if arming.state == "disarmed":
            self.commanded.gate.insist_on_silence(_DISARMED)
        elif state.why_blocked:
            self.commanded.gate.insist_on_silence(state.why_blocked)

    def _see_to_engagement(self, state: ArmState) -> None:
        """Where the session takes no more targets by itself, the commander has to engage anew."""
        if self._target is None or state.is_engaged:
            return
        reason = "the controller's session takes no more targets"
        self._end(reason)
        self.commanded.add_event("engagement-lost", "error", reason=reason)

    def _why_blocked(self, state: ArmState) -> str:
        if self.commanded.arming.state == "disarmed":
            return "the arm is disarmed"
        if self._target is None and state.is_moving:
            return self.commanded.gate.why_not_follow or "the arm still moves"
        return state.why_blocked

    def _send(self, wanted: Floats, state: ArmState) -> bool:
        """Hand over a target if it moved; return whether the session took it."""
        if self._target is None and not self._engage(state):
            return False
        target = aim(wanted, state.q, self.session.lead_rad)
        if self._target is not None and np.array_equal(target, self._target):
            return False
        self._refusal = self.session.send(target)
        if self._refusal and not self._was_refused:
            self.commanded.add_event("target-refused", "error", reason=self._refusal)
        self._was_refused = bool(self._refusal)
        if self._refusal:
            return False
        self._target = target
        return True

    def _engage(self, state: ArmState) -> bool:
        """Engage; return whether it was granted."""
        if refusal := self.session.engage():
            self._refusal = refusal
            self.commanded.add_event("engage-refused", "error", reason=refusal)
            self._end(refusal)
            return False
        self._target, self._was_refused = state.q, False
        return True

    def _end(self, reason: str) -> None:
        """Follow no command any more, and none again before its commander has let go."""
        self._release()
        self.commanded.gate.reset(reason)
        self.commanded.gate.insist_on_silence(reason)

    def _release(self) -> None:
        if self._target is not None:
            self._target = None
            self.session.release()


def result_values(
    robot: str, record: ArmRecord, commanded: CommandPath, armed: ArmAnswer | None, asked: ControllerAnswer | None
) -> dict[str, bytes]:
    """Return the values of a tick by key.

    Args:
        robot: Suffix of the arm's keys.
        record: What the tick did.
        commanded: Its command's way.
        armed: Answer to the last request to arm.
        asked: Answer to a request to the controller.
    """
    gate = commanded.status(record.decision)
    if record.refusal:
        gate["target_refused"] = record.refusal
    if armed is not None:
        gate["arm"] = msgspec.structs.asdict(armed)
    if asked is not None:
        gate["controller"] = msgspec.structs.asdict(asked)
    return {
        keys.target(robot): codec.f64(record.target),
        keys.command_gate(robot): codec.json_object(gate),
        keys.command_used(robot): codec.f64(record.decision.vector),
        keys.policy_timing(robot): codec.json_vector((record.tick, record.command_seq, *record.timing_ns)),
    }
