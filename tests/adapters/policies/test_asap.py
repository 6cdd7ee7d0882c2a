"""ASAP's policy of a G1's legs: what its network sees, number by number, its phase, and targets for legs and arms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.commands.g1_parts import ARMS
from adapters.policies.asap import AsapPolicy
from adapters.robots.g1 import joints as g1
from adapters.robots.g1.joints import G1_29
from station.errors import BadFile
from station.protocols import Floats, RobotState
from tests.adapters.policies.restored import expect_forgets, expect_goes_on
from tests.control.parted_walk import ASAP, walked

from .velocity_inputs import gravity, inputs, onnx_file

LEG = [-0.1, 0, 0, 0.3, -0.2, 0]
DEFAULT = np.array([*LEG, *LEG, *[0.0] * 17])
QUANTITIES = (
    "actions", "gyro", "yaw rate", "height", "velocity", "walks", "cosine", "q", "dq", "gravity", "upper", "sine",
)  # fmt: skip


@pytest.fixture
def policy(tmp_path: Path) -> AsapPolicy:
    return AsapPolicy(onnx_file(tmp_path / "asap.onnx", 500, 12))


def steps(count: int, seed: int = 0, stands: int = 7) -> list[tuple[RobotState, Floats]]:
    """States of 29 joints; velocities, zero in some of the steps, a height and two arms."""
    random = np.random.default_rng(seed + 50)
    made = []
    for number, (state, velocity) in enumerate(inputs(count, 29, seed)):
        height, arms = random.uniform(0.5, 0.8, 1), random.uniform(-0.4, 0.4, 14)
        made.append((state, np.concatenate([velocity * (number % stands > 1), height, arms])))
    return made


def quantities(state: RobotState, command: Floats, action: Floats, step: int) -> dict[str, Floats]:
    vx, vy, wz, height, *arms = command
    turn = 2 * np.pi * step / 40
    made = (
        np.clip(action, -100, 100), state.gyro * 0.25, [wz], [2.0 * height], [vx, vy], [float(vx or vy or wz) != 0.0],
        [np.cos(turn)], state.q - DEFAULT, state.dq * 0.05, gravity(state.quat_wxyz), [0, 0, 0, *arms], [np.sin(turn)],
    )  # fmt: skip
    return {name: np.array(each, np.float64) for name, each in zip(QUANTITIES, made, strict=True)}


def test_observations_are_the_facts_over_sixty_steps(policy: AsapPolicy) -> None:
    empty = quantities(*steps(1)[0], np.zeros(12), 0)
    past, action = [{name: each * 0.0 for name, each in empty.items()}] * 4, np.zeros(12, np.float32)
    walks, phase = False, 0
    for state, command in steps(60, stands=50):
        walked_before, walks = walks, bool(command[:3].any())
        phase = (phase + 1) % 40 if walks and walked_before else 0
        now = quantities(state, command, action.astype(np.float64), phase)
        history = [each[name] for name in QUANTITIES for each in past]  # the newest of each first
        expected = [*(now[name] for name in QUANTITIES[:9]), *history, *(now[name] for name in QUANTITIES[9:])]
        observation = policy.observe(state, command)
        assert (observation.shape, observation.dtype) == ((500,), np.float32)
        np.testing.assert_allclose(observation, np.concatenate(expected).astype(np.float32), rtol=0, atol=1e-6)
        policy._action = action = policy.act(observation) * np.float32(60)  # some of it beyond the clip
        past = [now, *past[:3]]


def test_targets_of_the_legs_are_about_the_default_pose_those_of_the_arms_as_commanded(policy: AsapPolicy) -> None:
    action = np.linspace(-150, 150, 12).astype(np.float32)
    ((_, command),) = steps(1)
    targets = policy.targets(action, command)
    moved = 0.25 * np.clip(action.astype(np.float64), -100, 100)
    np.testing.assert_array_equal(targets.q[:12], DEFAULT[:12] + moved)
    np.testing.assert_array_equal(targets.q[12:], [0, 0, 0, *command[4:]])
    assert targets.kp[:6].tolist() == [100, 100, 100, 200, 20, 20]
    assert targets.kp[12:22].tolist() == [400, 400, 400, 90, 60, 20, 60, 4, 4, 4]
    assert targets.kd[12:22].tolist() == [5, 5, 5, 2, 1, 0.4, 1, 0.2, 0.2, 0.2]


@pytest.mark.parametrize("is_run", [True, False])
@pytest.mark.parametrize("count", [12, 45])
def test_a_restored_policy_goes_on_bit_for_bit(policy: AsapPolicy, is_run: bool, count: int) -> None:
    other = AsapPolicy(policy.spec.checkpoint)
    for state, command in steps(3, seed=9):  # another past
        other.act(other.observe(state, command))
    expect_goes_on(policy, other, steps(count, seed=3), is_run=is_run)


def test_reset_forgets_everything(policy: AsapPolicy) -> None:
    expect_forgets(policy, steps(4))


def test_its_constants(policy: AsapPolicy) -> None:
    spec = policy.spec
    assert (spec.name, spec.command, spec.rate_hz) == ("asap", "g1-arms-velocity-height", 50.0)
    assert (spec.observation_size, spec.action_size, spec.joint_names) == (500, 12, G1_29)
    assert spec.command_lower is not None
    np.testing.assert_array_equal(spec.command_lower[4:], g1.lower(ARMS))


def test_a_network_of_another_kind_is_refused_in_one_line(tmp_path: Path) -> None:
    path = onnx_file(tmp_path / "other.onnx", 575, 12)
    with pytest.raises(BadFile, match=r"\[batch, 500\]") as caught:
        AsapPolicy(path)
    assert "\n" not in str(caught.value)


@pytest.mark.assets
@pytest.mark.usefixtures("assets")
def test_the_published_network_walks_with_arms_that_swing() -> None:
    """Commands of each part come, cease, are late or wrong; ten minutes of it are a proof (`tests/control`)."""
    way = [place for _, place in walked("asap", ASAP, 2.0, 20.0)]
    assert way[0] is not None
    assert way[-1] is not None
    assert np.linalg.norm((way[-1] - way[0])[:2]) > 0.3
