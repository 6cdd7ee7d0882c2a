"""TWIST's policy, over a TorchScript network of its shape that the test builds."""

from __future__ import annotations

import sys
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.policies.twist import DEFAULT_Q, OBSERVATION, TwistPolicy
from adapters.robots.g1.joints import G1_23, G1_25, G1_29
from station.errors import BadFile, StationError
from station.protocols import Floats, RobotState
from station.rotations import normalized, roll_pitch_yaw
from tests.adapters.policies.restored import expect_forgets, expect_goes_on

pytestmark = [pytest.mark.torch, pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")]

_WIRE_WITHOUT_WRIST_ROLLS = [index for index in range(33) if index not in (27, 32)]


def _script(path: Path, inputs: int, outputs: int) -> Path:
    import torch

    torch.manual_seed(0)
    network = torch.nn.Sequential(torch.nn.Linear(inputs, 32), torch.nn.ELU(), torch.nn.Linear(32, outputs))
    torch.jit.save(torch.jit.script(network), str(path))
    return path


@pytest.fixture
def policy(tmp_path: Path) -> TwistPolicy:
    return TwistPolicy(_script(tmp_path / "twist.pt", 1155, 23))


def _inputs(count: int) -> list[tuple[RobotState, Floats]]:
    random = np.random.default_rng(1)

    def state() -> RobotState:
        quat = normalized(np.array([1.0, 0, 0, 0]) + random.normal(size=4) * 0.1)
        return RobotState(0, random.normal(size=29), random.normal(size=29), quat, random.normal(size=3))

    return [(state(), random.normal(size=33)) for _ in range(count)]


def test_observations_equal_the_facts_bit_for_bit_over_fifteen_steps(policy: TwistPolicy) -> None:
    joints = [G1_29.index(name) for name in G1_23]
    past, action = deque([np.zeros(105, np.float32)] * 10, maxlen=10), np.zeros(23, np.float32)
    for state, command in _inputs(15):
        dq = state.dq[joints] * 0.05
        dq[[4, 5, 10, 11]] = 0.0
        proprioception = np.concatenate(
            [state.gyro * 0.25, roll_pitch_yaw(state.quat_wxyz)[:2], state.q[joints] - DEFAULT_Q, dq, action]
        ).astype(np.float32)
        frame = np.concatenate([command[_WIRE_WITHOUT_WRIST_ROLLS].astype(np.float32), proprioception])
        np.testing.assert_array_equal(policy.proprioception(state), proprioception)
        observation = policy.observe(state, command)
        assert observation.dtype == np.float32
        np.testing.assert_array_equal(observation, np.concatenate([frame, *past]))
        past.append(frame)
        action = policy.act(observation)
        assert action.shape == (23,)


def test_wrist_rolls_bypass_the_network_and_the_other_wrist_joints_stay_at_zero(policy: TwistPolicy) -> None:
    command = np.arange(33.0)
    action = np.linspace(-1, 1, 23).astype(np.float32)
    targets = dict(zip(G1_29, policy.targets(action, command).q, strict=True))
    assert targets["left_wrist_roll"] == 27.0
    assert targets["right_wrist_roll"] == 32.0
    for side in ("left", "right"):
        assert targets[f"{side}_wrist_pitch"] == targets[f"{side}_wrist_yaw"] == 0.0
    for name, offset, default in zip(G1_23, action, DEFAULT_Q, strict=True):
        assert targets[name] == float(offset) * 0.5 + default
    assert [8 + G1_25.index(f"{side}_wrist_roll") for side in ("left", "right")] == [27, 32]


@pytest.mark.parametrize("is_run", [True, False])
def test_a_restored_policy_goes_on_bit_for_bit(policy: TwistPolicy, is_run: bool) -> None:
    other = TwistPolicy(policy.spec.checkpoint)
    expect_goes_on(policy, other, _inputs(14), is_run=is_run)


def test_reset_forgets_everything(policy: TwistPolicy) -> None:
    expect_forgets(policy, _inputs(4))


def test_the_spec_is_that_of_29_driven_joints(policy: TwistPolicy) -> None:
    spec = policy.spec
    assert spec.joint_names == G1_29
    assert (spec.name, spec.command, spec.observation_size, spec.action_size) == ("twist", "twist", 1155, 23)
    assert OBSERVATION == 1155
    assert spec.runtime.startswith("torch ")


@pytest.mark.parametrize(("inputs", "outputs", "expected"), [(1432, 23, r"\(1, 1155\)"), (1155, 29, r"\(1, 23\)")])
def test_a_network_of_another_size_is_refused_in_one_line(
    tmp_path: Path, inputs: int, outputs: int, expected: str
) -> None:
    path = _script(tmp_path / "other.pt", inputs, outputs)
    with pytest.raises(BadFile, match=expected) as caught:
        TwistPolicy(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"hello", b"\x80\x02cos\nsystem\n."])
def test_a_file_that_is_no_torchscript_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "policy.pt"
    path.write_bytes(content)
    with pytest.raises(BadFile, match="not a TorchScript checkpoint") as caught:
        TwistPolicy(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadFile, match=r"gone\.pt: no such file"):
        TwistPolicy(tmp_path / "gone.pt")


def test_without_torch_the_error_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    modules: dict[str, Any] = sys.modules
    monkeypatch.setitem(modules, "torch", None)
    with pytest.raises(StationError, match=r"pip install 'teleop-station\[torch\]'"):
        TwistPolicy(tmp_path / "twist.pt")
