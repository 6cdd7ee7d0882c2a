"""Whether targets go to the robot: disarmed, arming (stiffness ramps up), armed. Pure; its time is given."""

from __future__ import annotations

import math
from typing import Literal

from station.control.command_validator import CommandValidator
from station.control.gate import Gate
from station.protocols import JointTargets

State = Literal["disarmed", "arming", "armed"]

RAMP_S = 2.0
"""Time from limp to full stiffness [s]: long enough for a person to see a limb go the wrong way."""

_ROUNDING = 1e-9  # a hundred ticks of 0.02 s are two seconds
_LONGEST_TICK_S = 0.1  # a clock that leaps makes no robot stiff at once


class Arming:
    """Starts disarmed, or armed where that is safe (a simulation).

    Args:
        is_armed: Whether it starts armed.
        ramp_s: Time from limp to full stiffness [s].
    """

    def __init__(self, *, is_armed: bool, ramp_s: float = RAMP_S) -> None:
        self._starts_armed = is_armed
        self.ramp_s = ramp_s
        self._ramped_s = 0.0
        self._now_s = 0.0
        self._state: State = "disarmed"
        self.restart()

    @property
    def state(self) -> State:
        """The present state, as of the last `apply`."""
        return self._state

    def arm(self, now_s: float) -> None:
        """Begin to ramp up; no effect when armed or arming."""
        if self._state == "disarmed":
            self._state, self._ramped_s, self._now_s = "arming", 0.0, now_s

    def disarm(self) -> None:
        """Send nothing from now on."""
        self._state = "disarmed"

    def restart(self) -> None:
        """Return to the state of the start."""
        self._state = "armed" if self._starts_armed else "disarmed"

    def apply(self, targets: JointTargets, now_s: float) -> JointTargets | None:
        """Return the targets with the stiffness of this instant; None when nothing may be sent.

        Damping is full from the start: a soft joint that is well damped creeps to its target instead of swinging.
        """
        if self._state == "disarmed":
            return None
        fraction = self.stiffen(now_s)
        return targets if fraction == 1.0 else JointTargets(targets.q, targets.kp * fraction, targets.kd)

    def stiffen(self, now_s: float) -> float:
        """Go on to an instant [s]; return how stiff the robot may be: 0 when disarmed, 1 when armed."""
        if self._state != "arming":
            return float(self._state == "armed")
        self._pass_time(now_s)
        fraction = self._ramped_s / self.ramp_s if self.ramp_s > 0 else 1.0
        if fraction >= 1.0 - _ROUNDING:
            self._state = "armed"
            return 1.0
        return fraction

    def _pass_time(self, now_s: float) -> None:
        if math.isfinite(now_s):
            self._ramped_s += min(max(0.0, now_s - self._now_s), _LONGEST_TICK_S)
            self._now_s = now_s


def why_not_arm(gate: Gate, validator: CommandValidator, now_s: float) -> str:
    """Return why a robot may not be armed now, or "". Where no command comes it is asked to stand, and may be."""
    if gate.state == "stopped":
        return f"the emergency stop is latched ({gate.reason}); release it first: station estop --reset"
    if validator.refusal is not None and validator.is_refusing(now_s, gate.config.return_after_s):
        return f"commands come and are refused ({validator.refusal.kind}: {validator.refusal.text}); mend their writer"
    if gate.state in ("holding", "returning"):
        return f"the command is stale ({gate.reason}); wait until the robot is asked to stand, or mend its writer"
    return ""
