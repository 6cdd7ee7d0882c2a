"""A policy in the place of HOMIE's, by LCM's own library: it hears a robot, waits for R2, calibrates, waits, and runs.

It knows nothing of the station's own messages: their layout stands here once more. The network is unitree_rl_gym's,
which drives 12 legs as HOMIE's does; it answers each new state, since it walks badly on one that is two steps old. Says
what it does, a line each: ``calibrates``, ``ready``, ``runs``.

    python -m tests.servers.homie_policy POLICY.pt [VX]
"""

from __future__ import annotations

import struct
import sys
import time
from pathlib import Path

import lcm
import numpy as np

from adapters.policies.rl_gym import RlGymG1Policy
from station.protocols import RobotState
from station.rotations import from_roll_pitch_yaw

STATE = struct.Struct(">Q3f3f3f3f3f3f3f4f4f3fq")
BODY = struct.Struct(">Q29f29fq")
REMOTE = struct.Struct(">Qh2f2f2f6h")
TARGETS = struct.Struct(">Q29d29dq")
STATE_TYPE, BODY_TYPE, REMOTE_TYPE, TARGETS_TYPE = (
    0x08BC31F1B8DA88F4, 0xF4F03934711BF8B5, 0x8EE4D605D87CFBC5, 0x86DB34943194C221,
)  # fmt: skip
CALIBRATED = np.array([-0.2, 0.0, 0.0, 0.6, -0.4, 0.0] * 2)
PERIOD_S, CALIBRATION_PERIOD_S = 0.02, 0.07
URL = "udpm://239.255.76.67:7667?ttl=0"


class Policy:
    """What HOMIE's deployment does, by another network.

    Args:
        checkpoint: Of the network.
        vx: How fast it walks [m/s].
    """

    def __init__(self, checkpoint: Path, vx: float) -> None:
        self._network, self._command = RlGymG1Policy(checkpoint), np.array([vx, 0.0, 0.0])
        self._rpy, self._gyro, self._q, self._dq = np.zeros(3), np.zeros(3), np.zeros(29), np.zeros(29)
        self._bodies, self._is_new, self._is_down, self._is_pressed = 0, False, False, False
        self._lcm = lcm.LCM(URL)
        for channel, heard in (
            ("state_estimator_data", self._on_state), ("body_control_data", self._on_body),
            ("rc_command", self._on_remote),
        ):  # fmt: skip
            self._lcm.subscribe(channel, heard)

    def run(self) -> None:
        """Run until killed."""
        self._await_press()
        say("calibrates")
        target = self._q[:12].copy()
        while np.abs(target - CALIBRATED).max() > 0.01:
            target -= np.clip(target - CALIBRATED, -0.05, 0.05)
            self._send(target)
            self._hear(time.monotonic() + CALIBRATION_PERIOD_S)
        say("ready")
        self._await_press()
        say("runs")
        self._network.reset()
        while True:
            self._hear(time.monotonic() + 2.0 * PERIOD_S, until_new=True)
            state = RobotState(0, self._q[:12], self._dq[:12], from_roll_pitch_yaw(self._rpy), self._gyro)
            action = self._network.act(self._network.observe(state, self._command))
            self._send(self._network.targets(action, self._command).q)

    def _await_press(self) -> None:
        self._is_pressed = False
        while not (self._is_pressed and self._bodies):
            self._lcm.handle_timeout(100)

    def _hear(self, until_s: float, *, until_new: bool = False) -> None:
        self._is_new = False
        while not (until_new and self._is_new) and (left_s := until_s - time.monotonic()) > 0.0:
            self._lcm.handle_timeout(max(1, round(left_s * 1e3)))

    def _send(self, legs: np.ndarray) -> None:
        row = [*legs, *[0.0] * (29 - 12 + 29)]
        self._lcm.publish("pd_plustau_targets", TARGETS.pack(TARGETS_TYPE, *row, int(time.time() * 1e6)))

    def _on_state(self, _: str, data: bytes) -> None:
        kind, *numbers = STATE.unpack(data)
        assert kind == STATE_TYPE
        self._rpy, self._gyro = np.array(numbers[:3]), np.array(numbers[3:6])

    def _on_body(self, _: str, data: bytes) -> None:
        kind, *numbers = BODY.unpack(data)
        assert kind == BODY_TYPE
        q = np.array(numbers[:29])
        self._is_new = self._is_new or not np.array_equal(q, self._q)
        self._q, self._dq = q, np.array(numbers[29:58])
        self._bodies += 1

    def _on_remote(self, _: str, data: bytes) -> None:
        kind, *numbers = REMOTE.unpack(data)
        assert kind == REMOTE_TYPE
        was_down, self._is_down = self._is_down, numbers[-1] == 1
        self._is_pressed = self._is_pressed or (self._is_down and not was_down)


def say(what: str) -> None:
    """Say what it does now."""
    print(what, flush=True)  # noqa: T201


if __name__ == "__main__":
    Policy(Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 0.0).run()
