"""pilla's walking policy of the H1: its layout and the two orders of its joints. Its file cannot be had."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.policies.pilla_h1 import PillaH1Policy
from adapters.robots.legged.unitree import H1
from station.errors import BadFile
from tests.adapters.policies.restored import expect_goes_on
from tests.adapters.policies.velocity_inputs import gravity, inputs, script

pytestmark = [pytest.mark.torch, pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")]

DEFAULT = {
    "left_hip_yaw": 0.0, "right_hip_yaw": 0.0, "torso": 0.0, "left_hip_roll": 0.0, "right_hip_roll": 0.0,
    "left_shoulder_pitch": 0.28, "right_shoulder_pitch": 0.28, "left_hip_pitch": -0.28, "right_hip_pitch": -0.28,
    "left_shoulder_roll": 0.0, "right_shoulder_roll": 0.0, "left_knee": 0.79, "right_knee": 0.79,
    "left_shoulder_yaw": 0.0, "right_shoulder_yaw": 0.0, "left_ankle": -0.52, "right_ankle": -0.52, "left_elbow": 0.52,
    "right_elbow": 0.52,
}  # fmt: skip
"""As the node lists them, in the network's order [rad]."""
JOINTS = [joint.name for joint in H1.joints]


@pytest.fixture
def policy(tmp_path: Path) -> PillaH1Policy:
    return PillaH1Policy(script(tmp_path / "h1_policy.pt", 69, 19))


def test_observations_and_targets_equal_the_facts_in_their_two_orders(policy: PillaH1Policy) -> None:
    assert list(policy.spec.joint_names) == JOINTS, "the built-in robot `h1` is the one that it drives"
    action = np.zeros(19, np.float32)
    for state, command in inputs(20, 19):
        q, dq = (dict(zip(JOINTS, values, strict=True)) for values in (state.q, state.dq))
        expected = np.concatenate([
            np.asarray(state.root_lin_vel), state.gyro, gravity(state.quat_wxyz), command,
            [q[name] - default for name, default in DEFAULT.items()], [dq[name] for name in DEFAULT], action,
        ])  # fmt: skip
        observation = policy.observe(state, command)
        assert observation.dtype == np.float32
        np.testing.assert_allclose(observation, expected.astype(np.float32), rtol=0, atol=1e-6)
        action = policy.act(observation)
        offsets = dict(zip(DEFAULT, action.astype(np.float64), strict=True))
        targets = policy.targets(action, command)
        np.testing.assert_allclose(targets.q, [DEFAULT[name] + 0.5 * offsets[name] for name in JOINTS], atol=1e-12)


def test_the_gains_are_those_of_the_task(policy: PillaH1Policy) -> None:
    gains = {name: (kp, kd) for name, kp, kd in zip(JOINTS, policy.spec.kp, policy.spec.kd, strict=True)}
    assert gains["left_hip_pitch"] == (200.0, 5.0)
    assert gains["right_ankle"] == (20.0, 4.0)
    assert gains["torso"] == (200.0, 5.0)
    assert gains["right_elbow"] == (40.0, 10.0)
    assert policy.spec.needs_root_velocity


@pytest.mark.parametrize("is_run", [True, False])
def test_a_restored_policy_goes_on_bit_for_bit(policy: PillaH1Policy, is_run: bool) -> None:
    expect_goes_on(policy, PillaH1Policy(policy.spec.checkpoint), inputs(10, 19, seed=2), is_run=is_run)


@pytest.mark.parametrize(("inputs", "outputs"), [(41, 10), (69, 12)])
def test_a_network_of_another_size_is_refused_in_one_line(tmp_path: Path, inputs: int, outputs: int) -> None:
    with pytest.raises(BadFile, match=r"expected an (in|out)put of \(1, (69|19)\)") as caught:
        PillaH1Policy(script(tmp_path / "other.pt", inputs, outputs))
    assert "\n" not in str(caught.value)
