"""What the robot's side allows: an emergency stop, a gate that follows or does not, the command it really follows."""

from __future__ import annotations

import msgspec
import numpy as np

from station.bus import codec, keys
from station.bus.sample import Sample
from station.bus.watch import Watch
from station.control.gate import FOLLOWING, LATCHED
from station.life import estop
from station.protocols import Floats

SILENT_S = 1.5
"""A robot's server that has not spoken for longer is gone [s]: in lock-step it waits a second for a command."""

FOLLOWS_WITHIN_S = 2.0
"""A gate that has not begun to follow us by then obeys another writer, or refuses us [s]."""

_LEAVING = ("holding", "returning")


class _Gate(msgspec.Struct, frozen=True):
    state: str = ""
    reason: str = ""
    arming: str = "armed"
    needs_silence: str = ""


class RobotSide:
    """Looks at the robot once per tick. A robot whose server has no gate (a stock one) allows everything.

    Args:
        watch: Watches the keys of `watched`.
        robot: Suffix of the robot's keys.
        size: Length of its command.
        holds_position: Whether it stays where it is without a command: then driving is not allowed before it has said
            where that is.

    Attributes:
        why_blocked: Why driving is not allowed now, or "".
        left: While we command: why the robot has ceased to follow us, or "".
        arming: Whether targets go to it: ``disarmed``, ``arming`` or ``armed``; the last one where it is not told.
        used: The command that the robot follows, shape (m,); None when unknown.
    """

    def __init__(self, watch: Watch, robot: str, size: int, *, holds_position: bool = False) -> None:
        self._watch, self._size, self._holds_position = watch, size, holds_position
        self._gate_key, self._used_key = keys.command_gate(robot), keys.command_used(robot)
        self._begun_ns: int | None = None  # since when we command
        self._has_followed = False
        self.why_blocked, self.left, self.arming = "", "", "armed"
        self.used: Floats | None = None

    @staticmethod
    def watched(robot: str) -> list[str]:
        """Return the keys that must be watched."""
        return [keys.command_gate(robot), keys.command_used(robot), keys.ESTOP]

    def begin(self, now_ns: int) -> None:
        """Record that our commands begin [ns, monotonic]."""
        self._begun_ns, self._has_followed = now_ns, False

    def end(self) -> None:
        """Record that our commands have ended."""
        self._begun_ns = None

    def poll(self, now_ns: int) -> None:
        """Read the robot's newest state at an instant [ns, monotonic]."""
        sample = self._watch.latest(self._gate_key)
        gate = _gate(sample)
        self.arming = gate.arming
        self.left = self._left(sample, gate, now_ns)
        self.used = self._used()
        self.why_blocked = self._stopped(gate) or self.left or self._not_ready(sample, gate, now_ns)

    def _stopped(self, gate: _Gate) -> str:
        if not self._watch.is_connected:
            return "the bus is lost"
        stop = self._watch.latest(keys.ESTOP)
        if gate.state == "stopped" or (stop is not None and estop.read(stop.value).stop):
            return "the emergency stop is latched"
        if gate.state == "faulted":
            return f"the robot's controller has a fault: {gate.reason}"
        return "" if gate.arming == "armed" else f"the robot is {gate.arming}"

    def _not_ready(self, sample: Sample | None, gate: _Gate, now_ns: int) -> str:
        if sample is not None and sample.age_s(now_ns) > SILENT_S:
            return "the robot's server is silent"
        if self._begun_ns is None and gate.state in _LEAVING:
            return "the robot is on its way to standing; wait for it"
        if self._begun_ns is None and gate.needs_silence:
            return gate.needs_silence
        if self._holds_position and self.used is None:
            return "the robot has not said where it is; is its server started?"
        return ""

    def _left(self, sample: Sample | None, gate: _Gate, now_ns: int) -> str:
        """Whether a robot that followed us does so no more; then only a new engaging moves it again."""
        if self._begun_ns is None or sample is None:
            return ""
        if sample.age_s(now_ns) > SILENT_S and self._has_followed:
            return "the robot's server is silent"
        if sample.arrived_ns is None or sample.arrived_ns < self._begun_ns:
            return ""
        if gate.state in FOLLOWING:
            self._has_followed = True
        elif self._has_followed or gate.state in LATCHED:
            return f"the robot follows no more ({gate.state}: {gate.reason})"
        elif (now_ns - self._begun_ns) * 1e-9 > FOLLOWS_WITHIN_S:
            return f"the robot does not follow ({gate.state}: {gate.reason})"
        return ""

    def _used(self) -> Floats | None:
        sample = self._watch.latest(self._used_key)
        if sample is None:
            return None
        try:
            vector = codec.parse_f64(sample.value)
        except codec.BadValue:  # what is none tells nothing; the gate judges commands, not we
            return None
        return vector if len(vector) == self._size and np.isfinite(vector).all() else None


def _gate(sample: Sample | None) -> _Gate:
    if sample is None:
        return _Gate()
    try:
        return codec.parse_struct(sample.value, _Gate)
    except codec.BadValue:
        return _Gate(state="stopped", reason="unreadable")
