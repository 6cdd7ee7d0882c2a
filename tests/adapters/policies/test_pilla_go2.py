"""pilla's walking policy of the Go2: its layout, the two orders of its joints, and its latency."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.policies.pilla_go2 import PillaGo2Policy
from station.errors import BadFile
from tests.adapters.policies.restored import expect_goes_on

from .velocity_inputs import gravity, inputs, script

pytestmark = [pytest.mark.torch, pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")]

MODEL = [f"{leg}_{joint}" for leg in ("FL", "FR", "RL", "RR") for joint in ("hip", "thigh", "calf")]
SDK = [f"{leg}_{joint}" for leg in ("FR", "FL", "RR", "RL") for joint in ("hip", "thigh", "calf")]
TO_SDK = [MODEL.index(name) for name in SDK]
TO_MODEL = [SDK.index(name) for name in MODEL]
THIGH = {"F": 0.8, "R": 1.0}
DEFAULT_SDK = np.array([{"hip": 0.0, "thigh": THIGH[name[0]], "calf": -1.5}[name.split("_")[1]] for name in SDK])


@pytest.fixture
def policy(tmp_path: Path) -> PillaGo2Policy:
    return PillaGo2Policy(script(tmp_path / "policy.jit", 45, 12))


def test_observations_equal_the_facts_in_the_order_of_the_sdk(policy: PillaGo2Policy) -> None:
    action = np.zeros(12, np.float32)
    for state, command in inputs(20, 12):
        expected = np.concatenate([
            state.gyro * 0.25, gravity(state.quat_wxyz), command * [2.0, 2.0, 0.25], state.q[TO_SDK] - DEFAULT_SDK,
            state.dq[TO_SDK] * 0.05, np.clip(action, -100, 100),
        ])  # fmt: skip
        observation = policy.observe(state, command)
        assert observation.dtype == np.float32
        np.testing.assert_allclose(observation, expected.astype(np.float32), rtol=0, atol=1e-6)
        action = policy.act(observation)
    assert list(policy.spec.joint_names) == MODEL


def test_what_is_applied_is_the_output_of_the_step_before_in_the_order_of_the_model(policy: PillaGo2Policy) -> None:
    before = np.zeros(12)
    for state, command in inputs(6, 12):
        action = policy.act(policy.observe(state, command))
        targets = policy.targets(action, command)
        np.testing.assert_allclose(targets.q, (DEFAULT_SDK + 0.25 * before)[TO_MODEL], rtol=0, atol=1e-12)
        before = action.astype(np.float64)
    policy.reset()
    state, command = inputs(1, 12)[0]
    action = policy.act(policy.observe(state, command))
    np.testing.assert_array_equal(policy.targets(action, command).q, DEFAULT_SDK[TO_MODEL])


@pytest.mark.parametrize("is_run", [True, False])
def test_a_restored_policy_goes_on_bit_for_bit(policy: PillaGo2Policy, is_run: bool) -> None:
    other = PillaGo2Policy(policy.spec.checkpoint)
    expect_goes_on(policy, other, inputs(10, 12, seed=2), is_run=is_run)


def test_its_range_is_not_the_same_both_ways(policy: PillaGo2Policy) -> None:
    np.testing.assert_array_equal(policy.spec.command_lower, [-1.0, -0.5, -0.5])
    np.testing.assert_array_equal(policy.spec.command_upper, [2.0, 0.5, 0.5])


@pytest.mark.parametrize(("inputs", "outputs"), [(48, 12), (45, 10)])
def test_a_network_of_another_size_is_refused_in_one_line(tmp_path: Path, inputs: int, outputs: int) -> None:
    with pytest.raises(BadFile, match=r"expected an (in|out)put of \(1, (45|12)\)") as caught:
        PillaGo2Policy(script(tmp_path / "other.jit", inputs, outputs))
    assert "\n" not in str(caught.value)
