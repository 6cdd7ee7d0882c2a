"""What the computer inside a G1 does with what it is sent, as far as it is known; what is not is a switch. Pure.

Facts and doubts, each with its source: what firmware does when commands cease is contradicted by every report, so all
three kinds are here (`G1Faults.without_commands`).
"""

from __future__ import annotations

import json
import math
from collections import Counter

import numpy as np

from adapters.robots.g1.dds import messages, words
from adapters.robots.g1.dds.remote import Sticks, remote_bytes
from adapters.robots.g1.joints import G1_29
from adapters.robots.g1.twin.body import JOINTS, Held
from adapters.robots.g1.twin.faults import G1Faults

OWN_CONTROLLER = "ai"
"""What the motion switcher calls the robot's own controller."""

CHECK, SELECT, RELEASE = 1001, 1002, 1003
_NOT_IMPLEMENTED, _BAD_PARAMETER = 3203, 3204

_STOP = {"L2", "B"}
_DEBUG = {"L2", "R2"}
_DAMPING_KD = 8.0
_OWN_DAMPING_KD = 3.0


class Firmware:
    """Which command the motors hold.

    Args:
        mode_machine: What the robot says it is: 5 for 29 joints, 6 for a locked waist.

    Attributes:
        controller: Name of the robot's own controller while it has the motors; "" once it is released.
        is_damped: Whether the remote has damped the robot, until it is put into debug mode or its mode is chosen anew.
        accepted: Commands that reached the motors.
        refused: Commands that did not, by reason.
    """

    def __init__(self, mode_machine: int) -> None:
        self.mode_machine = mode_machine
        self.controller = OWN_CONTROLLER
        self.is_damped = False
        self.accepted = 0
        self.refused: Counter[str] = Counter()
        self._faults = G1Faults()
        self._held = Held()
        self._slots = list(range(JOINTS))  # of a command, by motor
        self._last_s = -math.inf

    def change(self, faults: G1Faults) -> None:
        """Have other faults from now on; buttons of the remote are pressed by them."""
        new = set(faults.remote) - set(self._faults.remote)
        self._faults = faults
        self._slots = list(range(JOINTS))
        for pair in faults.swapped_joints.items():
            one, other = (G1_29.index(name) for name in pair)
            self._slots[one], self._slots[other] = other, one
        held = set() if faults.remote_off else set(faults.remote)
        if held >= _DEBUG and new & _DEBUG:
            self._release()
        if held >= _STOP and not faults.remote_stop_dead:
            self.is_damped = True

    def on_command(self, message: bytes, now_s: float) -> None:
        """Take a LowCmd, header included, that came at an instant [s], or refuse it and count why."""
        if why_not := self._why_not(message):
            self.refused[why_not] += 1
            return
        record = messages.command(message)
        assert record is not None
        self.accepted += 1
        self._last_s = now_s
        motors = record["motors"][0, :JOINTS]
        enabled = messages.modes(record, JOINTS) == 1
        held = self._held
        for name in ("q", "dq", "tau", "kp", "kd"):
            getattr(held, name)[:] = np.where(enabled, motors[name], 0.0)[self._slots]

    def request(self, api: int, parameter: str) -> tuple[int, str]:
        """Answer a request to the motion switcher; return code and data."""
        if api == CHECK:
            return 0, json.dumps({"form": "0", "name": self.controller})
        if api == RELEASE:
            self._release()
            return 0, ""
        if api != SELECT:
            return _NOT_IMPLEMENTED, ""
        if (name := words.name_of(parameter)) is None:
            return _BAD_PARAMETER, ""
        self._release()
        self.controller = name
        return 0, ""

    def held(self, now_s: float, *, is_own_turn: bool) -> Held:
        """Return what the motors hold at an instant [s].

        Args:
            now_s: On the clock of `on_command`.
            is_own_turn: Whether this is the turn of the robot's own controller, which writes in between.
        """
        if self.controller and (is_own_turn or self._faults.controller == "holds"):
            return _damping(_OWN_DAMPING_KD)
        if self.is_damped:
            return _damping(_DAMPING_KD)
        if self.is_without_commands(now_s):
            return _damping(_DAMPING_KD) if self._faults.without_commands == "damp" else Held()
        return self._held

    def is_without_commands(self, now_s: float) -> bool:
        """Whether the motors have given up waiting for commands."""
        silent_s = now_s - self._last_s
        return self._faults.without_commands != "hold" and silent_s > self._faults.without_commands_after_s

    def remote(self) -> bytes:
        """Return the forty bytes of the remote."""
        if self._faults.remote_off:
            return bytes(40)
        return remote_bytes(self._faults.remote, Sticks(*self._faults.sticks)).tobytes()

    def _release(self) -> None:
        """Let go of the motors: the robot is limp at once."""
        self.controller, self.is_damped = "", False
        self._held = Held()

    def _why_not(self, message: bytes) -> str:
        record = messages.command(message)
        if record is None:
            return "malformed"
        if not messages.is_intact(message):
            return "checksum"
        if record["mode_pr"][0] != 0:
            return "mode_pr"
        if record["mode_machine"][0] != self.mode_machine:
            return "mode_machine"
        motors = record["motors"][0, :JOINTS]
        if not all(np.isfinite(motors[name]).all() for name in ("q", "dq", "tau", "kp", "kd")):
            return "not finite"
        return "own controller holds" if self.controller and self._faults.controller == "holds" else ""


def _damping(kd: float) -> Held:
    return Held(kd=np.full(JOINTS, kd))
