"""TWIST2's policy: the observation number by number, the history, the targets, bad files."""

from __future__ import annotations

from collections import deque
from pathlib import Path

import numpy as np
import pytest

from adapters.policies import tracker
from adapters.policies.twist2 import DEFAULT_Q, OBSERVATION, Twist2Policy
from station.assets import resolve
from station.errors import BadFile, ConfigError
from station.protocols import Floats, Floats32, RobotState
from station.rotations import roll_pitch_yaw
from tests.adapters.policies.inputs import inputs

CHECKPOINT = "twist2/ckpts/twist2_1017_20k.onnx"
ANOTHER = Path(tracker.__file__).with_name("tracker.onnx")


@pytest.fixture
def policy(assets: Path) -> Twist2Policy:
    return Twist2Policy(assets / CHECKPOINT)


class _AsTheFactsSay:
    """The observation written down a second time, the plain way."""

    def __init__(self) -> None:
        self.past = deque([np.zeros(127, np.float32)] * 10, maxlen=10)
        self.action = np.zeros(29, np.float32)

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        dq = state.dq * 0.05
        dq[[4, 5, 10, 11]] = 0.0
        roll_pitch = roll_pitch_yaw(state.quat_wxyz)[:2]
        frame = np.concatenate(
            [command, state.gyro * 0.25, roll_pitch, state.q - DEFAULT_Q, dq, self.action]
        ).astype(np.float32)  # fmt: skip
        observation = np.concatenate([frame, *self.past, command.astype(np.float32)])
        self.past.append(frame)
        return observation


@pytest.mark.assets
def test_observations_equal_the_facts_bit_for_bit_over_fifteen_steps(policy: Twist2Policy) -> None:
    plain = _AsTheFactsSay()
    for state, command in inputs(15):
        observation = policy.observe(state, command)
        assert observation.dtype == np.float32
        assert observation.shape == (OBSERVATION,) == (1432,)
        np.testing.assert_array_equal(observation, plain.observe(state, command))
        plain.action = policy.act(observation)


@pytest.mark.assets
def test_the_first_observation_has_no_past_whatever_was_loaded_or_run_before(policy: Twist2Policy) -> None:
    (state, command), *more = inputs(5)
    first = policy.observe(state, command)
    assert not first[98:1397].any()
    action = policy.act(first)
    for later in more:
        policy.act(policy.observe(*later))
    policy.reset()
    np.testing.assert_array_equal(policy.observe(state, command), first)
    np.testing.assert_array_equal(policy.act(first), action)


@pytest.mark.assets
@pytest.mark.parametrize("is_run", [True, False])
@pytest.mark.parametrize("at", [0, 1, 12])
def test_a_restored_policy_goes_on_bit_for_bit(policy: Twist2Policy, assets: Path, at: int, is_run: bool) -> None:
    other = Twist2Policy(assets / CHECKPOINT)
    other.act(other.observe(*inputs(1, seed=9)[0]))
    for step, (state, command) in enumerate(inputs(at + 12)):
        observation = policy.observe(state, command)
        if step == at:
            other.restore(observation)
            if is_run:
                other.act(observation)
        elif step > at:
            np.testing.assert_array_equal(other.observe(state, command), observation)
            np.testing.assert_array_equal(other.act(observation), policy.act(observation))
            continue
        policy.act(observation)


@pytest.mark.assets
def test_an_observation_is_the_callers_own(policy: Twist2Policy) -> None:
    (state, command), (next_state, next_command) = inputs(2)
    observation = policy.observe(state, command)
    kept = observation.copy()
    policy.act(observation)
    policy.observe(next_state, next_command)
    np.testing.assert_array_equal(observation, kept)


@pytest.mark.assets
def test_targets_are_the_clipped_output_at_half_scale_around_the_default(policy: Twist2Policy) -> None:
    action = np.zeros(29, np.float32)
    action[:3] = (1.0, 40.0, -40.0)
    targets = policy.targets(action, np.zeros(35))
    np.testing.assert_array_equal(targets.q - DEFAULT_Q, [0.5, 5.0, -5.0] + [0.0] * 26)
    np.testing.assert_array_equal(targets.kp[:6], [100, 100, 100, 150, 40, 40])
    np.testing.assert_array_equal(targets.kd[12:22], [4, 4, 4, 5, 5, 5, 5, 0.2, 0.2, 0.2])


@pytest.mark.assets
@pytest.mark.parametrize(("name", "kp", "kd"), [("sim", 4, 0.2), ("real", 20, 1), ("training", 40, 5)])
def test_wrist_gains_are_chosen_by_name(assets: Path, name: str, kp: float, kd: float) -> None:
    spec = Twist2Policy(assets / CHECKPOINT, wrist_gains=name).spec  # type: ignore[arg-type]
    for wrists in (slice(19, 22), slice(26, 29)):
        np.testing.assert_array_equal(spec.kp[wrists], kp)
        np.testing.assert_array_equal(spec.kd[wrists], kd)


def test_unknown_wrist_gains_are_refused() -> None:
    with pytest.raises(ConfigError, match="sim, real, training"):
        Twist2Policy(ANOTHER, wrist_gains="soft")  # type: ignore[arg-type]


@pytest.mark.assets
def test_the_spec_names_checkpoint_hash_and_runtime(policy: Twist2Policy) -> None:
    spec = policy.spec
    assert spec.sha256 == "2d1fb3a31e4e967f70ecfefc3ad1e7b2ac491677068b89f60b565a94e7735061"
    assert spec.runtime.startswith("onnxruntime ")
    assert (spec.name, spec.command, spec.rate_hz) == ("twist2", "twist2", 50.0)
    assert (spec.observation_size, spec.action_size) == (1432, 29)


@pytest.mark.parametrize(
    ("checkpoint", "came"),
    [
        ("builtin:tracker.onnx", "observation [batch, 635]"),
        pytest.param("zoo:policies/holosoma_ppo_g1_29dof.onnx", "actor_obs [1, 100]", marks=pytest.mark.assets),
    ],
)
def test_a_checkpoint_of_another_input_size_is_refused_in_one_line(checkpoint: str, came: str) -> None:
    path = resolve(checkpoint)
    with pytest.raises(BadFile) as caught:
        Twist2Policy(path)
    assert str(caught.value) == (
        f"{path}: expected one float input [batch, 1432], the checkpoint has {came} tensor(float)"
    )


def test_a_torn_checkpoint_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "torn.onnx"
    path.write_bytes(ANOTHER.read_bytes()[:100_000])
    with pytest.raises(BadFile, match="not a usable ONNX checkpoint") as caught:
        Twist2Policy(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"hello", b"\x80\x04."])
def test_a_file_that_is_no_checkpoint_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "policy.onnx"
    path.write_bytes(content)
    with pytest.raises(BadFile) as caught:
        Twist2Policy(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_checkpoint_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadFile, match=r"gone\.onnx: no such file; expected an ONNX checkpoint"):
        Twist2Policy(tmp_path / "gone.onnx")
