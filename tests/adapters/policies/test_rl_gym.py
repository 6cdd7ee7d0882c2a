"""unitree_rl_gym's walking policies: their layout, and an LSTM whose state is recorded and restored."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from adapters.policies.rl_gym import RlGymG1Policy, RlGymH1Policy, RlGymH12Policy, RlGymPolicy
from adapters.policies.torchscript_network import LstmNetwork
from station.errors import BadFile, StationError
from tests.adapters.policies.restored import expect_goes_on

from .velocity_inputs import gravity, inputs

pytestmark = [pytest.mark.torch, pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")]

FAMILY = (RlGymG1Policy, RlGymH1Policy, RlGymH12Policy)
JOINTS = {RlGymG1Policy: 12, RlGymH1Policy: 10, RlGymH12Policy: 12}
DEFAULT = {
    RlGymG1Policy: [-0.1, 0, 0, 0.3, -0.2, 0] * 2,
    RlGymH1Policy: [0, 0, -0.1, 0.3, -0.2] * 2,
    RlGymH12Policy: [0, -0.16, 0, 0.36, -0.2, 0] * 2,
}


def script(path: Path, inputs: int, actions: int, units: int = 64) -> Path:
    """Write what upstream exports."""
    from . import lstm_script  # with torch, which takes two seconds

    return lstm_script.write(path, inputs, actions, units)


@pytest.fixture(params=FAMILY, ids=lambda each: each.NAME)
def policy(request: pytest.FixtureRequest, tmp_path: Path) -> RlGymPolicy:
    joints = JOINTS[request.param]
    return request.param(script(tmp_path / "motion.pt", 11 + 3 * joints, joints))


def test_observations_equal_the_facts_over_fifty_steps_and_the_outputs_are_those_of_the_module(
    policy: RlGymPolicy,
) -> None:
    import torch

    count, default = JOINTS[type(policy)], np.array(DEFAULT[type(policy)])
    alone = torch.jit.load(str(policy.spec.checkpoint))  # called once per step from its zero state, as upstream does
    action = np.zeros(count, np.float32)
    for step, (state, command) in enumerate(inputs(50, count), start=1):
        phase = step * 0.02 % 0.8 / 0.8
        expected = np.concatenate([
            state.gyro * 0.25, gravity(state.quat_wxyz), command * [2.0, 2.0, 0.25], state.q - default, state.dq * 0.05,
            action, [np.sin(2 * np.pi * phase), np.cos(2 * np.pi * phase)],
        ]).astype(np.float32)  # fmt: skip
        observation = policy.observe(state, command)
        assert observation.dtype == np.float32
        np.testing.assert_allclose(observation[: len(expected)], expected, rtol=0, atol=1e-6)
        with torch.inference_mode():
            memory = [alone.hidden_state.reshape(-1).numpy(), alone.cell_state.reshape(-1).numpy()]
            np.testing.assert_array_equal(observation[len(expected) :], np.concatenate(memory))
            theirs = alone(torch.from_numpy(observation[None, : len(expected)])).numpy()[0]
        action = policy.act(observation)
        np.testing.assert_array_equal(action, theirs)


def test_targets_are_a_quarter_radian_per_unit_about_the_default_pose(policy: RlGymPolicy) -> None:
    action = np.linspace(-2, 2, JOINTS[type(policy)]).astype(np.float32)
    expected = np.array(DEFAULT[type(policy)]) + 0.25 * action.astype(np.float64)
    np.testing.assert_array_equal(policy.targets(action, np.zeros(3)).q, expected)
    assert policy.spec.joint_names[0].startswith("left_hip_")
    assert len(policy.spec.joint_names) == len(policy.spec.kp) == len(policy.spec.kd) == JOINTS[type(policy)]


@pytest.mark.parametrize("is_run", [True, False])
def test_its_memory_is_restored_from_a_recorded_observation(policy: RlGymPolicy, is_run: bool) -> None:
    count = JOINTS[type(policy)]
    other = type(policy)(policy.spec.checkpoint)
    for state, command in inputs(5, count, seed=9):  # another past
        other.act(other.observe(state, command))
    expect_goes_on(policy, other, inputs(58, count, seed=3), is_run=is_run)


def test_the_same_observation_gives_the_same_output_whatever_was_asked_between(policy: RlGymPolicy) -> None:
    steps = inputs(4, JOINTS[type(policy)])
    observations = [policy.observe(*step) for step in steps]
    first = policy.act(observations[0])
    for other in observations[1:]:
        policy.act(other)
    np.testing.assert_array_equal(policy.act(observations[0]), first)


def test_reset_forgets_everything(policy: RlGymPolicy) -> None:
    (state, command), *more = inputs(4, JOINTS[type(policy)])
    first = policy.observe(state, command)
    assert not first[-128:].any(), "the LSTM knows nothing at the start, though loading has run it"
    for later in more:
        policy.act(policy.observe(*later))
    policy.reset()
    np.testing.assert_array_equal(policy.observe(state, command), first)


def test_a_network_for_another_robot_is_refused_in_one_line(tmp_path: Path) -> None:
    path = script(tmp_path / "h1.pt", 41, 10)
    with pytest.raises(BadFile, match=r"expected an input of \(1, 47\), the network refuses it") as caught:
        RlGymG1Policy(path)
    assert "\n" not in str(caught.value)
    with pytest.raises(BadFile, match=r"expected an output of \(1, 12\), the network gives \(1, 10\)"):
        RlGymG1Policy(script(tmp_path / "odd.pt", 47, 10))


def test_a_network_without_a_memory_or_with_another_is_refused_in_one_line(tmp_path: Path) -> None:
    import torch

    plain = tmp_path / "plain.pt"
    torch.jit.save(torch.jit.script(torch.nn.Linear(47, 12)), str(plain))
    for path in (plain, script(tmp_path / "small.pt", 47, 12, units=32)):
        with pytest.raises(
            BadFile, match="expected an LSTM whose state stands in hidden_state and cell_state"
        ) as caught:
            RlGymG1Policy(path)
        assert "\n" not in str(caught.value)


def test_without_torch_the_error_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(StationError, match=r"pip install 'teleop-station\[torch\]'"):
        LstmNetwork(tmp_path / "motion.pt", inputs=47, outputs=12, units=64)
