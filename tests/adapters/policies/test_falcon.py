"""FALCON's policy of a G1: what its network sees, number by number, and its targets for legs, waist and arms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.commands.g1_parts import ARMS
from adapters.policies.falcon import FalconPolicy
from adapters.robots.g1 import joints as g1
from adapters.robots.g1.joints import G1_29
from station.errors import BadFile
from station.protocols import Floats, RobotState
from tests.adapters.policies.restored import expect_forgets, expect_goes_on

from .velocity_inputs import gravity, inputs, onnx_file

LEG = [-0.1, 0, 0, 0.3, -0.2, 0]
DEFAULT = np.array([*LEG, *LEG, *[0.0] * 17])


@pytest.fixture
def policy(tmp_path: Path) -> FalconPolicy:
    return FalconPolicy(onnx_file(tmp_path / "falcon.onnx", 575, 29))


def steps(count: int, seed: int = 0) -> list[tuple[RobotState, Floats]]:
    """States of 29 joints; velocities, zero in every third step, a height, a torso and two arms."""
    random = np.random.default_rng(seed + 50)
    return [
        (
            state,
            np.concatenate([velocity * (number % 3 > 0), random.uniform(0.4, 0.7, 1), random.uniform(-0.4, 0.4, 17)]),
        )
        for number, (state, velocity) in enumerate(inputs(count, 29, seed))
    ]


def frame(state: RobotState, command: Floats, action: Floats) -> Floats:
    vx, vy, wz, height, roll, pitch, yaw, *arms = command
    made = np.zeros(115)
    made[0:29] = np.clip(action, -100, 100)
    made[29:32] = state.gyro * 0.25
    made[32], made[33], made[34], made[35] = wz, 2.0 * height, vx, vy
    made[36] = 0.0 if vx == vy == wz == 0.0 else 1.0
    made[37], made[38], made[39] = yaw, roll, pitch
    made[40:69] = state.q - DEFAULT
    made[69:98] = state.dq * 0.05
    made[98:101] = gravity(state.quat_wxyz)
    made[101:115] = arms
    return made


def test_observations_are_the_facts_frames_oldest_first_over_ten_steps(policy: FalconPolicy) -> None:
    frames, action = [np.zeros(115)] * 4, np.zeros(29, np.float32)
    for state, command in steps(10):
        frames = [*frames[-4:], frame(state, command, action.astype(np.float64))]
        observation = policy.observe(state, command)
        assert (observation.shape, observation.dtype) == ((575,), np.float32)
        np.testing.assert_allclose(observation, np.concatenate(frames).astype(np.float32), rtol=0, atol=1e-6)
        policy._action = action = policy.act(observation) * np.float32(60)  # some of it beyond the clip


def test_targets_of_the_arms_are_about_the_commanded_positions_and_those_of_the_legs_about_the_default_pose(
    policy: FalconPolicy,
) -> None:
    action = np.linspace(-150, 150, 29).astype(np.float32)
    ((_, command),) = steps(1)
    targets = policy.targets(action, command)
    moved = 0.25 * np.clip(action.astype(np.float64), -100, 100)
    np.testing.assert_array_equal(targets.q[:15], (DEFAULT + moved)[:15])
    np.testing.assert_array_equal(targets.q[15:], moved[15:] + command[7:])
    assert targets.kp[:6].tolist() == [100, 100, 100, 200, 20, 20]
    assert targets.kp[12:22].tolist() == [300, 300, 300, 90, 60, 20, 60, 4, 4, 4]
    assert targets.kd[:6].tolist() == [2.5, 2.5, 2.5, 5, 0.2, 0.1]
    assert targets.kd[12:22].tolist() == [5, 5, 5, 2, 1, 0.4, 1, 0.2, 0.2, 0.2]


@pytest.mark.parametrize("is_run", [True, False])
def test_a_restored_policy_goes_on_bit_for_bit(policy: FalconPolicy, is_run: bool) -> None:
    other = FalconPolicy(policy.spec.checkpoint)
    for state, command in steps(3, seed=9):  # another past
        other.act(other.observe(state, command))
    expect_goes_on(policy, other, steps(12, seed=3), is_run=is_run)


def test_reset_forgets_everything(policy: FalconPolicy) -> None:
    expect_forgets(policy, steps(4))


def test_its_constants(policy: FalconPolicy) -> None:
    spec = policy.spec
    assert (spec.name, spec.command, spec.rate_hz) == ("falcon", "g1-arms-velocity-posture", 50.0)
    assert (spec.observation_size, spec.action_size, spec.joint_names) == (575, 29, G1_29)
    assert spec.command_lower is not None
    assert spec.command_upper is not None
    assert spec.command_lower[:4].tolist() == [-0.5, -0.5, -1.0, 0.4]
    assert spec.command_upper[:4].tolist() == [1.0, 0.5, 1.0, 0.75]
    np.testing.assert_array_equal(spec.command_lower[7:], g1.lower(ARMS))


def test_a_network_of_another_kind_is_refused_in_one_line(tmp_path: Path) -> None:
    path = onnx_file(tmp_path / "other.onnx", 580, 29)
    with pytest.raises(BadFile, match=r"\[batch, 575\]") as caught:
        FalconPolicy(path)
    assert "\n" not in str(caught.value)
