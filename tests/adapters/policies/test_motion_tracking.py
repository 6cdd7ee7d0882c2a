"""motion_tracking's policy: what its network sees, number by number, which output is taken, and what it remembers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.policies.motion_tracking import MotionTrackingPolicy
from adapters.robots.g1.joints import G1_29
from station.control.rig import RigConfig, build
from station.errors import BadFile, ConfigError
from station.protocols import Floats, RobotState
from station.rehearse import rehearse_all
from station.rotations import normalized
from tests.adapters.policies.inputs import inputs
from tests.adapters.policies.restored import expect_forgets, expect_goes_on
from tests.adapters.policies.turned import looks, of_root, turned

LEVELS = (
    ("hip_pitch", "waist_yaw"), ("hip_roll", "waist_roll"), ("hip_yaw", "waist_pitch"), ("knee", "shoulder_pitch"),
    ("ankle_pitch", "shoulder_roll"), ("ankle_roll", "shoulder_yaw"), ("elbow",), ("wrist_roll",), ("wrist_pitch",),
    ("wrist_yaw",),
)  # fmt: skip
ISAAC = [
    name
    for level in LEVELS
    for part in level
    for name in ([part] if part.startswith("waist") else [f"left_{part}", f"right_{part}"])
]
ORDER = [G1_29.index(name) for name in ISAAC]
LEG, ARM = [-0.28, 0, 0, 0.5, -0.23, 0], [0.87, 0, 0, 0]
DEFAULT = np.array([*LEG, *LEG, 0, 0, 0, 0.35, 0.16, 0, *ARM, 0.35, -0.16, 0, *ARM])
OUTPUTS = ("policy", "priv_pred", "loc", "scale", "action", "sample_log_prob")


def tracking_file(path: Path, *, is_listed: bool = True, names: tuple[str, ...] = OUTPUTS) -> Path:
    """Write a linear network whose outputs have numbers for names, and beside it what its exporter says of them."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    weights = (np.random.default_rng(5).normal(size=(623, 29)) * 0.02).astype(np.float32)
    numbers = [str(100 + index) if is_listed else name for index, name in enumerate(names)]
    nodes = [
        helper.make_node("MatMul", ["obs", "weights"], [numbers[names.index("action")]]),
        *(helper.make_node("Relu", [numbers[names.index("action")]], [each])
          for each, name in zip(numbers, names, strict=True) if name != "action"),
    ]  # fmt: skip
    given = [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, 623])]
    made = [helper.make_tensor_value_info(each, TensorProto.FLOAT, [1, 29]) for each in numbers]
    graph = helper.make_graph(nodes, "tracking", given, made, [numpy_helper.from_array(weights, "weights")])
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), str(path))
    if is_listed:
        path.with_suffix(".json").write_text(json.dumps({"in_keys": ["policy"], "out_keys": names}))
    return path


@pytest.fixture
def policy(tmp_path: Path) -> MotionTrackingPolicy:
    return MotionTrackingPolicy(tracking_file(tmp_path / "made.onnx"))


def calm(count: int) -> list[tuple[RobotState, Floats]]:
    """States and commands of a robot that goes, turns slowly, leans and bends."""
    height, upright = np.eye(35)[2] * 0.75, np.eye(4)[0]
    return [
        (replace(state, quat_wxyz=normalized(state.quat_wxyz + upright)),
         command * [1, 1, 0.1, 1, 1, 0.2, *[1] * 29] + height)
        for state, command in inputs(count)
    ]  # fmt: skip


def moved(commands: list[Floats]) -> tuple[list[Floats], list[Floats]]:
    """Where commands lead from the first, which stands at 0 and looks along X: positions and rotations."""
    heading, position, positions, rotations = 0.0, np.zeros(3), [], []
    for index, command in enumerate(commands):
        vx, vy, height, roll, pitch, rate = command[:6].astype(np.float32).astype(float)
        before = commands[max(index - 1, 0)].astype(np.float32).astype(float)
        lean = turned(1, pitch) @ turned(0, roll)
        if index:
            heading += 0.02 * (rate + (pitch - before[4]) / 0.02 * np.sin(roll)) / (np.cos(pitch) * np.cos(roll))
            climb = (height - before[2]) / 0.02
            up = (climb - lean[2, 0] * vx - lean[2, 1] * vy) / lean[2, 2]
            position = position + 0.02 * turned(2, heading) @ lean @ [vx, vy, up]
        positions.append(np.array([*position[:2], height]))
        rotations.append(turned(2, heading) @ lean)
    return positions, rotations


def test_observations_equal_the_facts_over_thirty_steps(policy: MotionTrackingPolicy) -> None:
    steps = calm(30)
    asked = [steps[0][1]] * 16 + [command for _, command in steps]  # as if the first had always been
    positions, rotations = moved(asked)
    first, outputs = looks(of_root(steps[0][0].quat_wxyz)), [np.zeros(29)] * 3
    for step, (state, command) in enumerate(steps):
        frames = [step + ahead for ahead in (0, 2, 4, 8, 16)]
        robot, down = of_root(state.quat_wxyz), np.array([0, 0, -1.0])
        reference = [turned(2, first) @ rotations[frame] for frame in frames]
        joints = [asked[frame][6:][ORDER] for frame in frames]
        expected = [
            [0.0],
            *(rotations[step].T @ (positions[frame] - positions[step]) for frame in frames[1:]),
            *((robot.T @ each)[:, column] for each in reference for column in (0, 1)),
            [0, 0, 0], *joints, *(each - state.q[ORDER] for each in joints),
            [positions[frame][2] + 0.035 for frame in frames], *(each.T @ down for each in reference),
            state.gyro, robot.T @ down,
            *(steps[max(step - ago, 0)][0].q[ORDER] for ago in (0, 1, 2, 3, 4, 8)), *outputs[::-1],
        ]  # fmt: skip
        observation = policy.observe(state, command)
        assert (observation.dtype, observation.shape) == (np.float32, (policy.spec.observation_size,))
        np.testing.assert_allclose(observation[:623], np.concatenate(expected), rtol=5e-5, atol=5e-5)
        outputs = [*outputs[1:], np.clip(policy.act(observation), -10, 10)]


def test_only_what_the_network_knows_reaches_it(policy: MotionTrackingPolicy) -> None:
    (state, command), *_ = calm(1)
    observation = policy.observe(state, command)
    action = policy.act(observation)
    observation[623:] = 9.0
    np.testing.assert_array_equal(policy.act(observation), action)


def test_what_is_commanded_is_seen_now_sixteen_steps_later(policy: MotionTrackingPolicy) -> None:
    (state, command), *_ = calm(1)
    for _ in range(3):
        policy.observe(state, command)
    for step in range(17):
        seen = policy.observe(state, command + 0.1)[46 : 46 + 29]
        assert (step == 16) == np.allclose(seen, command[6:][ORDER] + 0.1)


def test_a_reference_that_turns_on_stays_within_reach_of_a_robot_that_does_not(policy: MotionTrackingPolicy) -> None:
    command = np.eye(35)[2] * 0.75 + np.eye(35)[5] * 3.0
    state = RobotState(mono_ns=0, q=DEFAULT, dq=np.zeros(29), quat_wxyz=np.eye(4)[0], gyro=np.zeros(3))
    for _ in range(200):
        observation = policy.observe(state, command)
    assert np.arctan2(observation[14], observation[13]) == pytest.approx(0.6, abs=1e-3)


def test_targets_are_in_the_robots_order_halved_where_legs_are_and_clipped(policy: MotionTrackingPolicy) -> None:
    action = np.linspace(-12.0, 12.0, 29).astype(np.float32)
    scale = {name: 1.0 if name.split("_")[1] in ("shoulder", "elbow", "wrist") else 0.5 for name in G1_29}
    expected = {name: scale[name] * np.clip(action[index], -10, 10) for index, name in enumerate(ISAAC)}
    made = policy.targets(action, np.zeros(35))
    np.testing.assert_allclose(made.q, DEFAULT + [expected[name] for name in G1_29])
    np.testing.assert_allclose(made.kp[[0, 1, 4, 12, 20]], [40.1792, 99.0984, 28.5012, 40.1792, 16.7783], rtol=1e-5)
    np.testing.assert_allclose(made.kd[[0, 1, 4, 12, 20]], [2.55789, 6.30880, 1.81445, 2.55789, 1.06814], rtol=1e-5)


def test_it_gives_way_where_it_is_told_to(tmp_path: Path) -> None:
    soft = MotionTrackingPolicy(tracking_file(tmp_path / "made.onnx"), compliance_n=15.0)
    np.testing.assert_allclose(soft.observe(*calm(1)[0])[43:46], [1.0, 15.0, 300.0])
    with pytest.raises(ConfigError, match="compliance_n 5: expected 0, or 10 to 20 N"):
        MotionTrackingPolicy(tmp_path / "made.onnx", compliance_n=5.0)


@pytest.mark.parametrize("is_run", [False, True])
@pytest.mark.parametrize("count", [6, 25])
def test_it_goes_on_from_a_recorded_observation(tmp_path: Path, count: int, *, is_run: bool) -> None:
    one, other = (MotionTrackingPolicy(tracking_file(tmp_path / f"{name}.onnx")) for name in "ab")
    other.observe(*calm(1)[0])
    expect_goes_on(one, other, calm(count), is_run=is_run)


def test_reset_it_begins_where_the_robot_looks(policy: MotionTrackingPolicy) -> None:
    expect_forgets(policy, calm(5))


def test_without_a_list_the_output_that_is_called_action_is_taken_or_the_only_one(tmp_path: Path) -> None:
    listed = MotionTrackingPolicy(tracking_file(tmp_path / "listed.onnx"))
    for name, names in (("named", OUTPUTS), ("only", ("action",))):
        other = MotionTrackingPolicy(tracking_file(tmp_path / f"{name}.onnx", is_listed=False, names=names))
        row = other.observe(*calm(1)[0])
        np.testing.assert_array_equal(other.act(row), listed.act(row))


@pytest.mark.parametrize("said", ["{", "[]", '{"out_keys": 3}', '{"out_keys": ["loc"]}', '{"out_keys": {}}',
                                  json.dumps({"out_keys": ["more"] * 9 + ["action"]})])  # fmt: skip
def test_a_list_that_does_not_say_which_output_is_the_action_is_refused_in_a_line(tmp_path: Path, said: str) -> None:
    path = tracking_file(tmp_path / "made.onnx")
    path.with_suffix(".json").write_text(said)
    with pytest.raises(BadFile, match=r"^[^\n]*made.json: does not say which of the 6 outputs of made.onnx [^\n]*$"):
        MotionTrackingPolicy(path)


def test_a_whole_motion_runs_in_the_loop(tmp_path: Path) -> None:
    options: dict[str, Any] = {"physics_dt_s": 0.002}
    config = RigConfig(policy="motion-tracking", checkpoint=str(tracking_file(tmp_path / "made.onnx")),
                       robot_options=options)  # fmt: skip
    rig = build(config)
    assert rig.command_format.name == "twist2"
    rig.robot.close()
    (done,) = rehearse_all(["builtin:wave"], config, jobs=1)
    assert done.fell, "a network of random weights balances nobody"
