"""mujoco_playground's joystick policies: their layout, the velocity that they need, and their phase."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adapters.policies.playground import PlaygroundG1Policy, PlaygroundGo1Policy
from adapters.robots.g1.joints import G1_29
from station.command_formats import command_format
from station.control.control import ControlStep
from station.errors import BadFile, ConfigError
from tests.adapters.policies.restored import expect_forgets, expect_goes_on
from tests.control.ideal_robot import IdealRobot

from .velocity_inputs import gravity, inputs, onnx_file

LEG = [-0.312, 0, 0, 0.669, -0.363, 0]
G1_DEFAULT = np.array([*LEG, *LEG, 0, 0, 0.073, 0.2, 0.2, 0, 0.6, 0, 0, 0, 0.2, -0.2, 0, 0.6, 0, 0, 0])
GO1_DEFAULT = np.array([0.1, 0.9, -1.8, -0.1, 0.9, -1.8, 0.1, 0.9, -1.8, -0.1, 0.9, -1.8])


@pytest.fixture
def g1(tmp_path: Path) -> PlaygroundG1Policy:
    return PlaygroundG1Policy(onnx_file(tmp_path / "g1.onnx", 103, 29))


@pytest.fixture
def go1(tmp_path: Path) -> PlaygroundGo1Policy:
    return PlaygroundGo1Policy(onnx_file(tmp_path / "go1.onnx", 48, 12))


def at_site(velocity: np.ndarray, gyro: np.ndarray, site: list[float]) -> np.ndarray:
    """The velocity of a place in a body that moves and turns."""
    x, y, z = site
    p, q, r = gyro
    return velocity + np.array([q * z - r * y, r * x - p * z, p * y - q * x])


def test_observations_of_the_g1_equal_the_facts_over_seventy_steps(g1: PlaygroundG1Policy) -> None:
    action, phase = np.zeros(29, np.float32), np.array([0.0, np.pi])
    for state, command in inputs(70, 29):
        expected = np.concatenate([
            at_site(state.root_lin_vel, state.gyro, [0.04525, 0.0, -0.08339]), state.gyro, gravity(state.quat_wxyz),
            command, state.q - G1_DEFAULT, state.dq, action, np.cos(phase), np.sin(phase),
        ])  # fmt: skip
        observation = g1.observe(state, command)
        assert observation.dtype == np.float32
        np.testing.assert_allclose(observation, expected.astype(np.float32), rtol=0, atol=2e-6)
        action = g1.act(observation)
        phase = np.mod(phase + 2 * np.pi * 1.5 * 0.02 + np.pi, 2 * np.pi) - np.pi  # after the inference


def test_observations_of_the_go1_equal_the_facts_and_the_command_is_last(go1: PlaygroundGo1Policy) -> None:
    action = np.zeros(12, np.float32)
    for state, command in inputs(20, 12):
        expected = np.concatenate([
            at_site(state.root_lin_vel, state.gyro, [-0.01592, -0.06659, -0.00617]), state.gyro,
            gravity(state.quat_wxyz), state.q - GO1_DEFAULT, state.dq, action, command,
        ])  # fmt: skip
        observation = go1.observe(state, command)
        np.testing.assert_allclose(observation, expected.astype(np.float32), rtol=0, atol=2e-6)
        action = go1.act(observation)
    assert go1.spec.joint_names[::3] == ("FR_hip", "FL_hip", "RR_hip", "RL_hip")
    np.testing.assert_array_equal(go1.spec.command_upper, [1.5, 0.8, 1.2])


def test_targets_are_half_a_radian_per_unit_about_the_default_pose(
    g1: PlaygroundG1Policy, go1: PlaygroundGo1Policy
) -> None:
    for policy, default in ((g1, G1_DEFAULT), (go1, GO1_DEFAULT)):
        action = np.linspace(-3, 3, len(default)).astype(np.float32)
        np.testing.assert_array_equal(policy.targets(action, np.zeros(3)).q, default + 0.5 * action.astype(np.float64))
    gains = dict(zip(G1_29, zip(g1.spec.kp.tolist(), g1.spec.kd.tolist(), strict=True), strict=True))
    assert gains["left_knee"] == gains["waist_pitch"] == gains["right_elbow"] == (75.0, 2.0)
    assert gains["right_ankle_pitch"] == (20.0, 1.0)
    assert gains["left_ankle_roll"] == gains["left_wrist_roll"] == gains["right_wrist_yaw"] == (2.0, 0.2)


@pytest.mark.parametrize("is_run", [True, False])
@pytest.mark.parametrize("steps", [1, 2, 34, 67, 100, 131])
def test_a_restored_policy_goes_on_bit_for_bit(g1: PlaygroundG1Policy, steps: int, is_run: bool) -> None:
    other = PlaygroundG1Policy(g1.spec.checkpoint)
    expect_goes_on(g1, other, inputs(steps + 2, 29, seed=steps), is_run=is_run)


def test_reset_forgets_everything(g1: PlaygroundG1Policy) -> None:
    expect_forgets(g1, inputs(4, 29))


def test_a_robot_that_does_not_measure_its_velocity_is_refused_in_one_line(g1: PlaygroundG1Policy) -> None:
    class Measuring(IdealRobot):
        def read(self):
            return replace(super().read(), root_lin_vel=np.zeros(3))

    ControlStep(Measuring(), g1, command_format("velocity", "g1_29"))
    with pytest.raises(
        ConfigError, match=r"'playground-g1'.* needs the velocity of the base, which this robot does not"
    ):
        ControlStep(IdealRobot(), g1, command_format("velocity", "g1_29"))


def test_a_policy_of_another_robot_is_refused_in_one_line(g1: PlaygroundG1Policy, tmp_path: Path) -> None:
    with pytest.raises(BadFile, match=r"expected one float input \[batch, 48\], the checkpoint has obs \[1, 103\]"):
        PlaygroundGo1Policy(g1.spec.checkpoint)
    with pytest.raises(BadFile, match=r"expected one float output \[batch, 12\]"):
        PlaygroundGo1Policy(onnx_file(tmp_path / "odd.onnx", 48, 29))
