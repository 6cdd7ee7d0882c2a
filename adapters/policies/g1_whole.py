"""A policy that drives some joints of a G1, for all of them: the others are held."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from adapters.policies.groot_wbc import GrootWbcPolicy
from adapters.robots.g1.joints import G1_29, WAIST
from adapters.robots.legged.table import LeggedRobot
from adapters.robots.legged.unitree import G1
from station.errors import ConfigError
from station.protocols import Floats, Floats32, JointTargets, Policy, PolicySpec, RobotState

_WAIST = 400.0, 20.0
"""Stiffness and damping of a waist that no policy drives [N m/rad, N m s/rad]. Measured under `rlgym-g1`, on our model:
at 250 and 5 the trunk shakes by 1.4 rad/s against the legs, at these by 0.1."""


class OnAllJoints:
    """Implements `station.protocols.Policy`.

    Args:
        inside: The policy.
        held: Where joints are held that it does not drive, shape (n,) [rad].
        what: What a user calls it, for errors: ``legs: policy 'homie'``.
        robot: Which G1; one with hands holds their joints by the gains of its table.

    Raises:
        ConfigError: it drives joints that a G1 does not have.
    """

    def __init__(self, inside: Policy, held: Floats, what: str, robot: LeggedRobot = G1) -> None:
        self._inside, given = inside, inside.spec
        names = robot.joint_names
        odd = [name for name in given.joint_names if name not in G1_29]
        if odd:
            raise ConfigError(f"{what} drives another robot: a G1 has no joint {', '.join(odd[:4])}")
        self._known = [names.index(name) for name in given.joint_names]
        default, kp, kd = held.copy(), np.array(robot.stand_kp), np.array(robot.stand_kd)
        body = [names.index(name) for name in G1_29]
        kp[body], kd[body] = GrootWbcPolicy.GAINS
        waist = [names.index(name) for name in WAIST]
        kp[waist], kd[waist] = _WAIST
        for whole, own in ((default, given.default_q), (kp, given.kp), (kd, given.kd)):
            whole[self._known] = own
        self._spec = replace(given, joint_names=names, default_q=default, kp=kp, kd=kd)

    @property
    def spec(self) -> PolicySpec:
        """The constants of the policy inside, for all joints of a G1."""
        return self._spec

    def reset(self) -> None:
        """Forget what the policy inside remembers."""
        self._inside.reset()

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation of the policy inside, of the joints that it knows."""
        return self._inside.observe(replace(state, q=state.q[self._known], dq=state.dq[self._known]), command)

    def act(self, observation: Floats32) -> Floats32:
        """Return the raw output of the policy inside."""
        return self._inside.act(observation)

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return the targets of the policy inside; the other joints are held."""
        made = self._inside.targets(action, command)
        q, kp, kd = self._spec.default_q.copy(), self._spec.kp.copy(), self._spec.kd.copy()
        q[self._known], kp[self._known], kd[self._known] = made.q, made.kp, made.kd
        return JointTargets(q, kp, kd)

    def restore(self, observation: Floats32) -> None:
        """Restore what the policy inside remembers."""
        self._inside.restore(observation)
