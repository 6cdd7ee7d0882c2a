"""Legs by a policy elsewhere: what is followed, with which gains, and that the robot stands once nothing comes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.commands.leg_targets import SHARE
from adapters.policies.g1_arms import G1ArmsPolicy
from adapters.policies.homie import HomiePolicy
from adapters.policies.leg_targets import LegTargetsPolicy
from adapters.policies.walk.policy import G1WalkPolicy
from station import assets
from station.bus import codec
from station.control.command_validator import CommandSample
from station.control.control import StepRecord
from station.control.rig import RigConfig, build
from tests.adapters.policies.restored import expect_goes_on

from .test_homie import steps

WALK, ARMS = assets.resolve(G1WalkPolicy.CHECKPOINT), np.linspace(-0.5, 0.5, 14)
TARGETS = np.linspace(-0.6, 0.6, 12)


def command(share: float) -> np.ndarray:
    return np.concatenate([TARGETS, [share], ARMS])


def test_without_a_share_it_is_the_policy_that_stands_and_with_all_of_it_the_targets_with_homies_gains() -> None:
    whole, stands = LegTargetsPolicy(WALK), G1ArmsPolicy(WALK, legs="g1-walk")
    still = np.concatenate([np.zeros(3), ARMS])
    for state, _ in steps(3, 4):
        action = whole.act(whole.observe(state, command(0.0)))
        np.testing.assert_array_equal(action, stands.act(stands.observe(state, still)))
    own = stands.targets(action, still)
    made = [whole.targets(action, command(share)) for share in (0.0, 0.5, 1.0)]
    np.testing.assert_array_equal(made[0].q, own.q)
    np.testing.assert_array_equal(made[0].kp, own.kp)
    np.testing.assert_allclose(made[2].q, [*TARGETS, 0.0, 0.0, 0.0, *ARMS])
    np.testing.assert_allclose([made[2].kp, made[2].kd], HomiePolicy.GAINS)
    np.testing.assert_allclose(made[1].q, (made[0].q + made[2].q) / 2)


@pytest.mark.parametrize("is_run", [True, False])
def test_an_audit_goes_on_from_a_recorded_observation(is_run: bool) -> None:
    made = [(state, command(0.3)) for state, _ in steps(12, 4)]
    expect_goes_on(LegTargetsPolicy(WALK), LegTargetsPolicy(WALK), made, is_run=is_run)


class Walked:
    """A simulated G1 whose legs a policy elsewhere moves, one step late, as it is over a network."""

    def __init__(self, checkpoint: Path) -> None:
        self.control = build(RigConfig(robot="g1-mujoco", policy="g1-leg-targets")).control()
        self._elsewhere, self._asked = G1WalkPolicy(checkpoint), np.zeros(12)
        self._now_s, self._sample = 0.0, None
        self.steps: list[StepRecord] = []

    def run(self, seconds: float, *, vx: float = 0.0, is_silent: bool = False) -> StepRecord:
        for _ in range(round(seconds / 0.02)):
            state, velocity = self.control.sense(), np.array([vx, 0.0, 0.0])
            action = self._elsewhere.act(self._elsewhere.observe(state, velocity))
            if not is_silent:
                value = codec.json_vector(np.append(self._asked, 1.0))
                self._sample = CommandSample(value, arrived_s=self._now_s, source="elsewhere")
            self._asked = self._elsewhere.targets(action, velocity).q[:12]
            self.steps.append(self.control.step(state, (self._sample, None, None), self._now_s))
            self._now_s += 0.02
        return self.steps[-1]


def test_a_robot_whose_policy_falls_silent_in_mid_walk_stands_by_itself() -> None:
    robot = Walked(WALK)
    robot.run(1.0, is_silent=True)
    walking = robot.run(5.0, vx=0.4)
    assert walking.decision.vector[SHARE] == 1.0
    assert walking.state.root_pos is not None
    assert walking.state.root_pos[0] > 1.0
    caught = robot.run(0.4, is_silent=True)
    assert caught.decision.vector[SHARE] == 0.0
    still = robot.run(4.0, is_silent=True)
    assert [step for step in robot.steps if step.fall] == []
    assert still.state.root_lin_vel is not None
    assert np.linalg.norm(still.state.root_lin_vel) < 0.1
    assert [(e.detail["from"], e.detail["to"]) for s in robot.steps for e in s.step_events if e.name == "gate"] == [
        ("waiting", "entering"), ("entering", "tracking"), ("tracking", "holding"), ("holding", "returning"),
        ("returning", "waiting"),
    ]  # fmt: skip


def test_after_a_stop_a_policy_that_sent_through_it_is_not_followed_before_it_has_paused() -> None:
    robot = Walked(WALK)
    robot.run(2.0)
    robot.control.stop("test")
    assert robot.run(0.5).sent.kp.max() == 0.0
    robot.control.reset("test")
    assert robot.run(1.0).decision.vector[SHARE] == 0.0
    robot.run(0.5, is_silent=True)
    assert robot.run(2.0).decision.vector[SHARE] == 1.0
    assert robot.steps[-1].fall is None
