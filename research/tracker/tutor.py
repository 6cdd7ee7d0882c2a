"""What the teacher would have done: TWIST2's network for legs and waist, the motors' own equation for the arms.

TWIST2 knows arms that move as people's do. Shown an arm behind the back, it loses the legs as well: with arms taken
to poses drawn from their whole ranges it falls every half minute. So it is shown calm arms, all that concerns them
drawn towards the standing pose; what the real ones weigh it feels as a push and balances. The arms themselves need
no policy: the target that takes a joint along its command is known, from its gains and the weight that it carries.
"""

from __future__ import annotations

import numpy as np

from adapters.policies.twist2 import ACTION_SCALE, COMMAND, DEFAULT_Q, FRAME, PAST
from adapters.robots.g1 import joints
from adapters.robots.g1.joints import G1_29
from research.collector import Histories
from research.crowd import CONTROL_DT_S, States
from research.teacher import Network
from station.protocols import Floats, Floats32

ARMS = np.array([i for i, name in enumerate(G1_29) if any(part in name for part in ("shoulder", "elbow", "wrist"))])
_WRISTS = np.array(["wrist" in G1_29[i] for i in ARMS])
_FASTEST_RAD_S = 8.0  # beyond it a command is a jump, which no motor follows
_JOINTS_AT, _SPEEDS_AT, _ACTIONS_AT, _COMMANDS_AT = 40, 69, 98, 6  # in a frame
_OF_ARMS = np.concatenate([at + ARMS for at in (_COMMANDS_AT, _JOINTS_AT, _SPEEDS_AT, _ACTIONS_AT)])
_HOME = np.concatenate([DEFAULT_Q[ARMS], np.zeros(3 * len(ARMS))]).astype(np.float32)


class Tutor:
    """Labels for n robots, step by step.

    Args:
        network: The teacher's.
        robots: Their number.
        calm: How far from home the arms are that the teacher sees, over how far they are.
        kp, kd: Gains, shape (29,).
    """

    def __init__(self, network: Network, robots: int, calm: float, kp: Floats, kd: Floats) -> None:
        self._network, self._calm = network, calm
        self._kp, self._lag_s = kp[ARMS], kd[ARMS] / kp[ARMS]
        self._past = Histories(robots, PAST, FRAME)
        self._before: Floats = np.full((robots, len(ARMS)), np.nan)

    def forget(self, robot: int) -> None:
        """Begin anew with one robot."""
        self._past.clear(robot)
        self._before[robot] = np.nan

    def __call__(self, newest: Floats32, states: States, commands: Floats) -> Floats32:
        """Return the actions for this step, shape (n, 29).

        Args:
            newest: Frames of this step, free of noise, shape (n, 127).
            states: What they were made of.
            commands: Likewise, shape (n, 35).
        """
        shown = newest.copy()
        shown[:, _OF_ARMS] = _HOME + self._calm * (newest[:, _OF_ARMS] - _HOME)
        labels = self._network(np.concatenate([shown, self._past.flat, shown[:, :COMMAND]], axis=1))
        self._past.push(shown)
        labels[:, ARMS] = (self._arms(states, commands) - DEFAULT_Q[ARMS]) / ACTION_SCALE
        return labels

    def _arms(self, states: States, commands: Floats) -> Floats:
        """Targets that take the arms along their commands: ahead by what damping and weight pull them back."""
        wanted = commands[:, _COMMANDS_AT + ARMS]
        speed = np.nan_to_num((wanted - self._before) / CONTROL_DT_S)
        self._before = wanted
        # Without weight at the wrists: their gains differ between simulation and robot, and gears hold them there.
        weight = np.where(_WRISTS, 0.0, states.bias[:, ARMS] / self._kp)
        ahead = self._lag_s * np.clip(speed, -_FASTEST_RAD_S, _FASTEST_RAD_S) + np.clip(weight, -0.4, 0.4)
        low, high = joints.lower(G1_29)[ARMS] - 0.3, joints.upper(G1_29)[ARMS] + 0.3
        return np.asarray(np.clip(wanted + ahead, low, high))
