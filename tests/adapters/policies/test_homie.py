"""HOMIE's and GR00T's policies of a G1's legs: frames in their order to the last number, and what each drives."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from adapters.policies.follower import FramedFollower
from adapters.policies.groot_wbc import GrootWbcPolicy
from adapters.policies.homie import HomiePolicy
from adapters.robots.g1.joints import G1_29
from station.control.rig import RigConfig, build
from station.errors import BadFile, ConfigError, StationError
from station.protocols import Floats, Floats32, RobotState
from tests.adapters.policies.restored import expect_forgets, expect_goes_on

from .velocity_inputs import gravity, inputs, onnx_file

LEG = [-0.1, 0, 0, 0.3, -0.2, 0]
DEFAULT = np.array([*LEG, *LEG, *[0.0] * 17])
STAND = {HomiePolicy: [0, 0, 0, 0.74], GrootWbcPolicy: [0, 0, 0, 0.74, 0, 0, 0]}
SIZES = {HomiePolicy: (76, 12), GrootWbcPolicy: (86, 15)}
Step = tuple[RobotState, Floats]


def steps(count: int, size: int, seed: int = 0) -> list[Step]:
    """States of 29 joints, and velocities with a height and what is behind it."""
    random = np.random.default_rng(seed + 100)
    return [
        (state, np.concatenate([velocity, [random.uniform(0.3, 0.7)], random.uniform(-0.4, 0.4, size - 4)]))
        for state, velocity in inputs(count, 29, seed)
    ]


def homie_frame(state: RobotState, command: Floats, action: Floats) -> Floats:
    seen = [*range(13), *range(15, 29)]
    frame = np.zeros(76)
    frame[0:4] = command * [2.0, 2.0, 0.5, 1.0]
    frame[4:7] = state.gyro * 0.5
    frame[7:10] = gravity(state.quat_wxyz)
    frame[10:37] = (state.q - DEFAULT)[seen]
    frame[37:64] = state.dq[seen] * 0.05
    frame[64:76] = np.clip(action, -100, 100)
    return frame


def groot_frame(state: RobotState, command: Floats, action: Floats) -> Floats:
    frame = np.zeros(86)
    frame[0:3] = command[:3] * [2.0, 2.0, 0.5]
    frame[3:7] = command[3:7]
    frame[7:10] = state.gyro * 0.5
    frame[10:13] = gravity(state.quat_wxyz)
    frame[13:42] = state.q - DEFAULT
    frame[42:71] = state.dq * 0.05
    frame[71:86] = np.clip(action, -100, 100)
    return frame


FRAMES: dict[type, Callable[[RobotState, Floats, Floats], Floats]] = {
    HomiePolicy: homie_frame, GrootWbcPolicy: groot_frame,
}  # fmt: skip


def made(kind: type, folder: Path) -> FramedFollower:
    size, actions = SIZES[kind]
    first = onnx_file(folder / "first.onnx", 6 * size, actions)
    if kind is HomiePolicy:
        return HomiePolicy(first)
    return GrootWbcPolicy(first, walk=str(onnx_file(folder / "walk.onnx", 6 * size, actions, scale=-0.2)))


@pytest.fixture(params=SIZES, ids=lambda kind: kind.NAME)
def policy(request: pytest.FixtureRequest, tmp_path: Path) -> FramedFollower:
    return made(request.param, tmp_path)


def test_observations_are_the_facts_frames_oldest_first_over_ten_steps(policy: FramedFollower) -> None:
    kind = type(policy)
    size, actions = SIZES[kind]
    frames, action = [np.zeros(size)] * 5, np.zeros(actions, np.float32)
    for state, command in steps(10, len(STAND[kind])):
        frames = [*frames[-5:], FRAMES[kind](state, command, action.astype(np.float64))]
        observation = policy.observe(state, command)
        expected = np.concatenate(frames[-6:]).astype(np.float32)
        assert (observation.shape, observation.dtype) == ((6 * size,), np.float32)
        np.testing.assert_allclose(observation, expected, rtol=0, atol=1e-6)
        policy._action = action = policy.act(observation) * np.float32(60)  # some of it beyond the clip


def test_at_the_start_the_older_frames_are_zero(policy: FramedFollower) -> None:
    ((state, command),) = steps(1, len(STAND[type(policy)]))
    observation = policy.observe(state, command)
    size = SIZES[type(policy)][0]
    assert not observation[: 5 * size].any()
    assert observation[5 * size :].any()


def test_it_drives_the_first_joints_and_holds_the_others_at_zero(policy: FramedFollower) -> None:
    actions = SIZES[type(policy)][1]
    action = np.linspace(-150, 150, actions).astype(np.float32)
    expected = DEFAULT.copy()
    expected[:actions] += 0.25 * np.clip(action.astype(np.float64), -100, 100)
    targets = policy.targets(action, np.array(STAND[type(policy)]))
    np.testing.assert_array_equal(targets.q, expected)
    assert (policy.spec.joint_names, policy.spec.action_size) == (G1_29, actions)
    assert len(targets.kp) == len(targets.kd) == 29


def test_gains_are_those_that_act_on_the_robot(tmp_path: Path) -> None:
    homie, groot = (made(kind, tmp_path).spec for kind in SIZES)
    assert homie.kp[:6].tolist() == [150, 150, 150, 300, 40, 40]
    assert homie.kp[12:22].tolist() == [300, 300, 300, 150, 150, 150, 100, 10, 10, 5]
    assert homie.kd[15:22].tolist() == [4, 4, 4, 1, 0.5, 0.5, 0.5]
    assert groot.kp[:6].tolist() == [150, 150, 150, 200, 40, 40]
    assert groot.kp[12:22].tolist() == [250, 250, 250, 100, 100, 40, 40, 20, 20, 20]
    assert groot.kd[15:22].tolist() == [5, 5, 2, 2, 2, 2, 2]


def test_the_range_is_the_trained_one_with_the_height(tmp_path: Path) -> None:
    homie, groot = (made(kind, tmp_path).spec for kind in SIZES)
    assert (homie.command, groot.command) == ("velocity-height", "velocity-posture")
    np.testing.assert_array_equal(homie.command_lower, [-0.8, -0.5, -0.8, 0.24])
    np.testing.assert_array_equal(homie.command_upper, [1.2, 0.5, 0.8, 0.74])
    assert groot.command_lower is not None
    assert len(groot.command_lower) == 7


@pytest.mark.parametrize("is_run", [True, False])
def test_a_restored_policy_goes_on_bit_for_bit(policy: FramedFollower, tmp_path: Path, is_run: bool) -> None:
    size = len(STAND[type(policy)])
    other = made(type(policy), tmp_path)
    for state, command in steps(3, size, seed=9):  # another past
        other.act(other.observe(state, command))
    expect_goes_on(policy, other, steps(12, size, seed=3), is_run=is_run)


def test_reset_forgets_everything(policy: FramedFollower) -> None:
    expect_forgets(policy, steps(4, len(STAND[type(policy)])))


def test_groot_balances_below_a_velocity_of_five_hundredths_and_walks_above(tmp_path: Path) -> None:
    policy = made(GrootWbcPolicy, tmp_path)
    ((state, _),) = steps(1, 7)

    def output(*velocity: float) -> tuple[Floats32, Floats32]:
        policy.reset()
        observation = policy.observe(state, np.array([*velocity, 0.74, 0, 0, 0]))
        return policy.act(observation), observation

    for velocity, file in (((0.03, 0.03, 0.02), "first"), ((0.0, 0.0, 0.06), "walk"), ((0.04, -0.04, 0.0), "walk")):
        import onnxruntime

        action, observation = output(*velocity)
        alone = onnxruntime.InferenceSession(str(tmp_path / f"{file}.onnx"), providers=["CPUExecutionProvider"])
        np.testing.assert_allclose(action, alone.run(None, {"obs": observation[None]})[0][0], rtol=0, atol=1e-5)


def test_groot_without_its_second_network_says_which(tmp_path: Path) -> None:
    first = onnx_file(tmp_path / "first.onnx", 516, 15)
    with pytest.raises(ConfigError, match=r"name the one that walks with the option `walk`, the file …-Walk.onnx"):
        GrootWbcPolicy(first)
    with pytest.raises(StationError) as caught:
        GrootWbcPolicy(first, walk=str(tmp_path / "none.onnx"))
    assert "none.onnx" in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(BadFile, match=r"\[batch, 516\]"):
        GrootWbcPolicy(first, walk=str(onnx_file(tmp_path / "homie.onnx", 456, 12)))


@pytest.mark.parametrize(("inputs", "outputs", "words"), [(516, 12, r"\[batch, 456\]"), (456, 15, r"\[batch, 12\]")])
def test_a_network_of_other_sizes_is_refused_in_one_line(tmp_path: Path, inputs: int, outputs: int, words: str) -> None:
    with pytest.raises(BadFile, match=words) as caught:
        HomiePolicy(onnx_file(tmp_path / "other.onnx", inputs, outputs))
    assert "\n" not in str(caught.value)


def test_without_its_file_the_user_is_told_where_it_comes_from_and_under_which_licence() -> None:
    with pytest.raises(ConfigError, match=r"take it from InternRobotics/OpenHomie on GitHub \(CC BY-NC-SA 4.0"):
        build(RigConfig(robot="g1-mujoco", policy="homie"))


def test_another_robot_is_refused_in_one_line(tmp_path: Path) -> None:
    file = str(onnx_file(tmp_path / "first.onnx", 456, 12))
    rig = build(RigConfig(robot="g1-12-mujoco", policy="homie", checkpoint=file))
    with pytest.raises(ConfigError, match="policy 'homie' drives 29 joints, the robot has 12") as caught:
        rig.control()
    assert "\n" not in str(caught.value)
