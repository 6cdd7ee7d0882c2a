"""Two Dynamixel servos that turn a robot's head. They hold a position by themselves, and are limp without torque.

Source: ROBOTIS e-Manual, control table of X-series servos (torque enable 64, goal position 116); amazon-far/TWIST2 (two
servos, 0 yaw and 1 pitch, 2 Mbit/s). TWIST2's own program for its neck is not published.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from adapters.commands.hands import NECK
from adapters.devices.gello.bus import RAD_PER_TICK, DynamixelBus
from adapters.devices.serial_port import PortGone
from adapters.robots.neck.options import NeckOptions
from station.clock import SYSTEM, Clock
from station.errors import NotReady
from station.protocols import Fall, Floats, JointTargets, RobotState

SILENT_S = 0.3
"""A neck that said nothing for longer is not driven on [s]."""

_TORQUE_ENABLE, _GOAL_POSITION = 64, 116
_ATTEMPTS = 5
_MISSES, _ASKS_AGAIN_EVERY = (
    5,
    10,
)  # answers that are missing, then periods: each is waited for for longer than a period
_UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


class DynamixelNeck:
    """Implements `station.protocols.Robot` and `SelfChecking`. Not thread safe.

    Args:
        options: Its servos.
        control_dt_s: Control period [s].
        clock: Of the process.

    Raises:
        DeviceError: its port cannot be opened.
        NotReady: a servo does not answer.
    """

    joint_names = NECK

    def __init__(self, options: NeckOptions, control_dt_s: float, clock: Clock = SYSTEM) -> None:
        self._options, self._dt_s, self._clock = options, control_dt_s, clock
        self._zero, self._signs = np.array(options.zero_ticks), np.array(options.signs)
        self._most = np.array(options.most_rad)
        self._q = self._dq = np.zeros(len(NECK))
        self._heard_s, self._polls, self._misses = -np.inf, 0, 0
        self._is_stiff = False
        self._fault = self._refused = ""
        self._bus = DynamixelBus(options.port, options.baud, clock, device="neck", setting="robot_options.port")
        until_s = clock.monotonic_s() + options.first_state_within_s
        while not self._take():
            if clock.monotonic_s() > until_s:
                silent = [id_ for id_ in options.ids if id_ not in self._bus.ping([id_], attempts=_ATTEMPTS)]
                self._bus.close()
                raise NotReady(
                    f"servo {silent[0] if silent else options.ids[0]} of the neck does not answer on {options.port} at "
                    f"{options.baud} bit/s: does it have power, is it set to this rate and number (ids, baud)?"
                )

    def read(self) -> RobotState:
        """Return where it is, asking the servos."""
        self._polls += 1
        if not self._fault and (self._misses < _MISSES or self._polls % _ASKS_AGAIN_EVERY == 0):
            try:
                self._misses = 0 if self._take() else self._misses + 1
            except PortGone as error:
                self._fault = str(error)
        return RobotState(self._clock.monotonic_ns(), self._q, self._dq, _UPRIGHT, np.zeros(3))

    def _take(self) -> bool:
        shown = self._bus.positions(self._options.ids)
        if shown is None:
            return False
        now_s = self._clock.monotonic_s()
        q = (shown - self._zero * RAD_PER_TICK) * self._signs
        since_s = now_s - self._heard_s
        self._dq = (q - self._q) / since_s if self._dt_s / 2 < since_s < SILENT_S else np.zeros(len(q))
        self._q, self._heard_s = q, now_s
        return True

    def write(self, targets: JointTargets) -> JointTargets:
        """Have it go to a position within its ends; its gains are its own."""
        zeros: Floats = np.zeros(len(self._q))
        if not (np.isfinite(targets.q).all() and targets.kp.any() and self._have_torque(is_on=True)):
            self._have_torque(is_on=False)
            return JointTargets(self._q, zeros, zeros)
        q = np.clip(targets.q, -self._most, self._most)
        ticks = np.rint(q * self._signs / RAD_PER_TICK).astype(int) + self._zero
        self._try(
            lambda: self._bus.write_together(_GOAL_POSITION, dict(zip(self._options.ids, ticks.tolist(), strict=True)))
        )
        return JointTargets(q, targets.kp, targets.kd)

    def damp(self) -> None:
        """Take the torque out of it: the head sinks."""
        self._have_torque(is_on=False)

    def _have_torque(self, *, is_on: bool) -> bool:
        """Have the servos hold, or not; return whether they do as they were told."""
        if is_on == self._is_stiff or self._fault:
            return is_on == self._is_stiff
        done = [
            self._try(lambda id_=id_: self._bus.write(id_, _TORQUE_ENABLE, int(is_on))) for id_ in self._options.ids
        ]
        self._refused = "" if all(done) or not is_on else "a servo of the neck did not take its torque on"
        self._is_stiff = is_on if all(done) else self._is_stiff
        return all(done)

    def _try(self, call: Any) -> bool:
        try:
            return call() is not False
        except PortGone as error:
            self._fault = str(error)
            return False

    def fallen(self) -> Fall | None:
        """A neck cannot fall."""
        return None

    def why_not_arm(self) -> str:
        """Return why it must not be armed, or ""."""
        return self.why_not_drive()

    def why_not_drive(self) -> str:
        """Return why its torque has to go now, or ""."""
        silent_s = self._clock.monotonic_s() - self._heard_s
        if self._fault:
            return self._fault
        return f"its servos have said nothing for {silent_s:.2f} s" if silent_s > SILENT_S else self._refused

    def why_stand(self) -> str:
        """There is nothing that it could end better than by letting go."""
        return ""

    def pop_actions(self) -> list[str]:
        """A neck has no buttons."""
        return []

    def release(self) -> None:
        """Nothing else has its servos."""

    def releasing(self) -> tuple[bool, str]:
        """There is nothing to release."""
        return False, "a neck has no controller of its own"

    def values(self) -> Mapping[str, bytes]:
        """All that it measures is in its state."""
        return {}

    def health(self) -> dict[str, Any]:
        """Return what a heartbeat tells of it."""
        return {"why_not_arm": self.why_not_arm()}

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of it."""
        return {"backend": "dynamixel", "port": self._options.port, "ids": list(self._options.ids)}

    def close(self) -> None:
        """Leave it limp."""
        self._have_torque(is_on=False)
        self._bus.close()
