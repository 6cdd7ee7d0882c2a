"""The tracker: its observation number by number, its history, its shipped network."""

from __future__ import annotations

from collections import deque
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from adapters.policies.tracker.policy import OBSERVATION, TrackerPolicy
from adapters.policies.twist2 import DEFAULT_Q
from station.errors import BadFile, ConfigError
from station.rotations import roll_pitch_yaw
from tests.adapters.policies.inputs import inputs

CHECKPOINT = Path(__file__).parents[4] / "adapters/policies/tracker/tracker.onnx"


@pytest.fixture
def policy() -> TrackerPolicy:
    return TrackerPolicy(CHECKPOINT)


def test_an_observation_is_the_five_newest_frames_oldest_first(policy: TrackerPolicy) -> None:
    frames = deque([np.zeros(127, np.float32)] * 5, maxlen=5)
    action = np.zeros(29, np.float32)
    for state, command in inputs(8):
        observation = policy.observe(state, command)
        speeds = state.dq * 0.05
        speeds[[4, 5, 10, 11]] = 0.0
        tilt = roll_pitch_yaw(state.quat_wxyz)[:2]
        frames.append(
            np.concatenate([command, state.gyro * 0.25, tilt, state.q - DEFAULT_Q, speeds, action]).astype(np.float32)
        )
        assert observation.shape == (OBSERVATION,) == (635,)
        np.testing.assert_array_equal(observation, np.concatenate(frames))
        action = policy.act(observation)


def test_after_a_reset_all_is_as_at_the_start(policy: TrackerPolicy) -> None:
    (state, command), *more = inputs(5)
    first = policy.observe(state, command)
    assert not first[:508].any()
    action = policy.act(first)
    for later in more:
        policy.act(policy.observe(*later))
    policy.reset()
    np.testing.assert_array_equal(policy.observe(state, command), first)
    np.testing.assert_array_equal(policy.act(first), action)


@pytest.mark.parametrize("is_run", [True, False])
@pytest.mark.parametrize("at", [0, 1, 7])
def test_a_restored_policy_goes_on_bit_for_bit(policy: TrackerPolicy, at: int, is_run: bool) -> None:
    other = TrackerPolicy(CHECKPOINT)
    other.act(other.observe(*inputs(1, seed=9)[0]))
    for step, (state, command) in enumerate(inputs(at + 7)):
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


def test_an_observation_is_the_callers_own(policy: TrackerPolicy) -> None:
    (state, command), (next_state, next_command) = inputs(2)
    observation = policy.observe(state, command)
    kept = observation.copy()
    policy.act(observation)
    policy.observe(next_state, next_command)
    np.testing.assert_array_equal(observation, kept)


def test_targets_and_gains_are_those_of_its_teachers_family(policy: TrackerPolicy) -> None:
    action = np.zeros(29, np.float32)
    action[:3] = (1.0, 40.0, -40.0)
    targets = policy.targets(action, np.zeros(35))
    np.testing.assert_array_equal(targets.q - DEFAULT_Q, [0.5, 5.0, -5.0] + [0.0] * 26)
    np.testing.assert_array_equal(targets.kp[:6], [100, 100, 100, 150, 40, 40])
    np.testing.assert_array_equal(TrackerPolicy(CHECKPOINT, wrist_gains="real").spec.kp[19:22], 20)


def test_the_shipped_network_is_small_and_says_what_it_was_made_of() -> None:
    assert CHECKPOINT.stat().st_size <= 2_000_000
    session = onnxruntime.InferenceSession(str(CHECKPOINT), providers=["CPUExecutionProvider"])
    facts = session.get_modelmeta().custom_metadata_map
    assert facts["teacher_sha256"] == "2d1fb3a31e4e967f70ecfefc3ad1e7b2ac491677068b89f60b565a94e7735061"
    assert facts["seed"].isdigit()


def test_whatever_is_observed_the_output_is_finite(policy: TrackerPolicy) -> None:
    for scale in (1.0, 1e3, 1e6):
        observation = (np.random.default_rng(1).normal(size=OBSERVATION) * scale).astype(np.float32)
        assert np.isfinite(policy.act(observation)).all()


def test_unknown_wrist_gains_are_refused() -> None:
    with pytest.raises(ConfigError, match="sim, real, training"):
        TrackerPolicy(CHECKPOINT, wrist_gains="soft")  # type: ignore[arg-type]


@pytest.mark.assets
def test_a_checkpoint_of_another_family_is_refused_in_one_line(tmp_path: Path, assets: Path) -> None:
    path = assets / "twist2/ckpts/twist2_1017_20k.onnx"
    with pytest.raises(BadFile, match=r"expected one float input \[batch, 635\]") as caught:
        TrackerPolicy(path)
    assert "\n" not in str(caught.value)
