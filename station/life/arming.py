"""Whether targets go to the robot: disarmed, arming (stiffness ramps up), armed. Pure; its time is given."""

from __future__ import annotations

from typing import Literal

from station.protocols import JointTargets

State = Literal["disarmed", "arming", "armed"]

RAMP_S = 2.0
"""Time from limp to full stiffness [s]: long enough for a person to see a limb go the wrong way."""


class Arming:
    """Starts disarmed, or armed where that is safe (a simulation).

    Args:
        is_armed: Whether it starts armed.
        ramp_s: Time from limp to full stiffness [s].
    """

    def __init__(self, *, is_armed: bool, ramp_s: float = RAMP_S) -> None:
        self._starts_armed = is_armed
        self._ramp_s = ramp_s
        self._since_s: float | None = None
        self._state: State = "disarmed"
        self.restart()

    @property
    def state(self) -> State:
        """The present state, as of the last `apply`."""
        return self._state

    def arm(self, now_s: float) -> None:
        """Begin to ramp up; no effect when armed or arming."""
        if self._state == "disarmed":
            self._state, self._since_s = "arming", now_s

    def disarm(self) -> None:
        """Send nothing from now on."""
        self._state, self._since_s = "disarmed", None

    def restart(self) -> None:
        """Return to the state of the start."""
        self._state = "armed" if self._starts_armed else "disarmed"
        self._since_s = None

    def apply(self, targets: JointTargets, now_s: float) -> JointTargets | None:
        """Return the targets with the stiffness of this instant; None when nothing may be sent.

        Damping is full from the start: a soft joint that is well damped creeps to its target instead of swinging.
        """
        if self._state == "disarmed":
            return None
        if self._state == "armed" or self._since_s is None:
            return targets
        fraction = max(0.0, (now_s - self._since_s) / self._ramp_s) if self._ramp_s > 0 else 1.0
        if fraction >= 1.0:
            self._state = "armed"
            return targets
        return JointTargets(targets.q, targets.kp * fraction, targets.kd)
