"""Holosoma's walking policy: its layout, its phase, and what it can be told from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from adapters.policies.holosoma import HolosomaPolicy
from adapters.robots.g1.joints import G1_29
from station.errors import BadFile
from station.protocols import Floats
from tests.adapters.policies.restored import expect_forgets, expect_goes_on

from .velocity_inputs import gravity, inputs, onnx_file

LEG = [-0.312, 0, 0, 0.669, -0.363, 0]
DEFAULT = np.array([*LEG, *LEG, 0, 0, 0, 0.2, 0.2, 0, 0.6, 0, 0, 0, 0.2, -0.2, 0, 0.6, 0, 0, 0])
FACTS = {
    "dof_names": json.dumps([f"{name}_joint" for name in G1_29]),
    "kp": json.dumps([40.0 + index for index in range(29)]),
    "kd": json.dumps([2.0 + index / 10 for index in range(29)]),
}
STILL = np.zeros(3)


@pytest.fixture
def policy(tmp_path: Path) -> HolosomaPolicy:
    return HolosomaPolicy(onnx_file(tmp_path / "walk.onnx", 100, 29, FACTS))


def phases(observation: Floats) -> list[float]:
    """Of the left and the right foot, from 0 to 1."""
    return (np.arctan2(observation[98:100], observation[35:37]) / (2 * np.pi) % 1.0).tolist()


def test_observations_equal_the_facts_to_the_last_bit_over_sixty_steps(policy: HolosomaPolicy) -> None:
    action = np.zeros(29, np.float32)
    for step, (state, command) in enumerate(inputs(60, 29), start=1):
        left = step / 50.0 % 1.0  # rounded anew in each step, as a whole number of fiftieths
        angle = 2 * np.pi * np.array([(step % 50) / 50, (step % 50) / 50 + 0.5])
        assert angle[0] == pytest.approx(2 * np.pi * left)
        vx, vy, wz = command
        expected = np.zeros(100)
        expected[0:29] = np.clip(action, -100, 100)
        expected[29:32] = state.gyro * 0.25
        expected[32], expected[33], expected[34] = wz, vx, vy
        expected[35:37] = np.cos(angle)
        expected[37:66] = state.q - DEFAULT
        expected[66:95] = state.dq * 0.05
        expected[95:98] = gravity(state.quat_wxyz)
        expected[98:100] = np.sin(angle)
        observation = policy.observe(state, command)
        assert observation.dtype == np.float32
        np.testing.assert_allclose(observation, expected.astype(np.float32), rtol=0, atol=1e-6)
        exact = [*range(95), 98, 99]  # gravity is the same sum in another order
        np.testing.assert_array_equal(observation[exact], expected.astype(np.float32)[exact])
        action = policy.act(observation) * np.float32(40)  # some of it beyond the clip
        policy._action = action


def test_it_stands_at_a_command_of_zero_and_begins_a_stride_at_its_beginning(policy: HolosomaPolicy) -> None:
    (state, walk), *_ = inputs(1, 29)
    assert phases(policy.observe(state, walk)) == pytest.approx([0.02, 0.52]), "at start-up it advances first"
    for _ in range(7):
        policy.observe(state, walk)
    for _ in range(3):
        assert phases(policy.observe(state, STILL)) == pytest.approx([0.5, 0.5])
    assert phases(policy.observe(state, np.array([0.0, 0.0099, 0.0099]))) == pytest.approx([0.5, 0.5]), "that is still"
    assert phases(policy.observe(state, np.array([0.0, 0.0, -0.011])))[1] == pytest.approx(0.5)
    assert phases(policy.observe(state, walk)) == pytest.approx([0.02, 0.52])


def test_targets_are_a_quarter_radian_per_unit_about_the_default_pose(policy: HolosomaPolicy) -> None:
    action = np.linspace(-150, 150, 29).astype(np.float32)
    targets = policy.targets(action, STILL)
    np.testing.assert_array_equal(targets.q, DEFAULT + 0.25 * np.clip(action.astype(np.float64), -100, 100))
    np.testing.assert_array_equal(targets.kp, np.arange(40.0, 69.0))
    np.testing.assert_allclose(targets.kd, 2.0 + np.arange(29) / 10)


@pytest.mark.parametrize("is_run", [True, False])
@pytest.mark.parametrize("pause", [0, 1])
def test_a_restored_policy_goes_on_bit_for_bit(policy: HolosomaPolicy, is_run: bool, pause: int) -> None:
    other = HolosomaPolicy(policy.spec.checkpoint)
    steps = inputs(73, 29, seed=1)
    stands = [
        (state, STILL if pause and 60 < number < 71 else command) for number, (state, command) in enumerate(steps)
    ]
    expect_goes_on(policy, other, stands, is_run=is_run)


def test_reset_forgets_everything(policy: HolosomaPolicy) -> None:
    expect_forgets(policy, inputs(4, 29))


def test_its_constants(policy: HolosomaPolicy) -> None:
    spec = policy.spec
    assert (spec.name, spec.command, spec.rate_hz) == ("holosoma", "velocity", 50.0)
    assert (spec.observation_size, spec.action_size, spec.joint_names) == (100, 29, G1_29)
    np.testing.assert_array_equal(spec.command_lower, [-1, -1, -1])
    np.testing.assert_array_equal(spec.command_upper, [1, 1, 1])


@pytest.mark.parametrize(
    ("inputs", "outputs", "facts", "words"),
    [
        (103, 29, FACTS, r"\[batch, 100\]"),
        (100, 12, FACTS, r"\[batch, 29\]"),
        (100, 29, {}, "its metadata has no list 'dof_names'"),
        (100, 29, FACTS | {"dof_names": json.dumps(["left_hip_yaw_joint"])}, "is for other joints"),
        (100, 29, FACTS | {"kp": "[1, 2]"}, "29 numbers each for kp and kd"),
        (100, 29, FACTS | {"kd": '["a"]'}, "29 numbers each for kp and kd"),
    ],
)
def test_a_network_of_another_kind_is_refused_in_one_line(
    tmp_path: Path, inputs: int, outputs: int, facts: dict[str, str], words: str
) -> None:
    path = onnx_file(tmp_path / "other.onnx", inputs, outputs, facts)
    with pytest.raises(BadFile, match=words) as caught:
        HolosomaPolicy(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
