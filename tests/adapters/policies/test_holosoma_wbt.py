"""Holosoma's whole-body tracking: what its network sees, number by number, its scales, and the clip in its file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.motions import onnx_file
from adapters.motions.load import load
from adapters.policies.holosoma_wbt import HolosomaTrackingPolicy
from adapters.robots.g1.joints import G1_29
from adapters.robots.g1.kinematics import INDEX, forward
from station.control.rig import RigConfig, build
from station.errors import BadFile
from station.protocols import Floats, Motion, RobotState
from station.rehearse import rehearse
from station.rotations import normalized, roll_pitch_yaw
from tests.adapters.policies.inputs import inputs
from tests.adapters.policies.restored import expect_forgets, expect_goes_on
from tests.adapters.policies.turned import looks, of_root, turned
from tests.adapters.policies.velocity_inputs import onnx_file as walking_file

LEG = [-0.312, 0, 0, 0.669, -0.363, 0]
DEFAULT = np.array([*LEG, *LEG, 0, 0, 0, 0.2, 0.2, 0, 0.6, 0, 0, 0, 0.2, -0.2, 0, 0.6, 0, 0, 0])
KP, EFFORT = np.linspace(10.0, 40.0, 29), np.linspace(5.0, 139.0, 29)
ZOO = "zoo:policies/holosoma_wbt_{}_g1_29dof_dancing.onnx"
ROWS = 12


def metadata(**more: Any) -> dict[str, str]:
    listed = {"dof_names": [f"{name}_joint" for name in G1_29], "kp": KP.tolist(), "kd": [1.0] * 29}
    return {name: json.dumps(value) for name, value in (listed | more).items()}


CONFIG = {
    "robot": {
        "control": {"action_scale": 0.25, "action_scales_by_effort_limit_over_p_gain": True},
        "dof_effort_limit_list": EFFORT.tolist(),
    }
}


def tracking_file(
    path: Path, facts: dict[str, str] | None = None, *, rows: int = ROWS, clip: dict[str, Floats] | None = None
) -> Path:
    """Write a linear network with a clip beside it, as Holosoma exports them."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    random = np.random.default_rng(3)
    tables = {
        "joint_pos": wandering(random, np.zeros(29), rows),
        "ref_pos_xyz": wandering(random, np.array([3.0, -1.0, 0.8]), rows),
        "ref_quat_xyzw": normalized(wandering(random, np.array([0, 0, 0.8, 0.6]), rows)),
    } | (clip or {})
    weights = (random.normal(size=(154, 29)) * 0.02).astype(np.float32)
    nodes = [
        helper.make_node("MatMul", ["obs", "weights"], ["actions"]),
        helper.make_node("Min", ["time_step", "last"], ["bounded"]),
        helper.make_node("Cast", ["bounded"], ["row"], to=TensorProto.INT64),
        helper.make_node("Reshape", ["row", "one"], ["index"]),
        *(helper.make_node("Gather", [f"{name}_table", "index"], [name], axis=0) for name in tables),
    ]
    given = [("obs", 154), ("time_step", 1)]
    made = [("actions", 29), *((name, table.shape[1]) for name, table in tables.items())]
    constants = {
        "weights": weights, "last": np.full((1, 1), rows - 1, np.float32), "one": np.array([1], np.int64),
        **{f"{name}_table": table.astype(np.float32) for name, table in tables.items()},
    }  # fmt: skip
    graph = helper.make_graph(
        nodes, "tracking",
        *([helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, size]) for name, size in each]
          for each in (given, made)),
        [numpy_helper.from_array(value, name) for name, value in constants.items()],
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    helper.set_model_props(model, metadata() if facts is None else facts)
    onnx.save(model, str(path))
    return path


def wandering(random: np.random.Generator, start: Floats, rows: int) -> Floats:
    """A table that begins near a row and changes little from one row to the next."""
    return np.asarray(start + np.cumsum(random.normal(size=(rows, len(start))) * 0.01, axis=0))


@pytest.fixture
def policy(tmp_path: Path) -> HolosomaTrackingPolicy:
    return HolosomaTrackingPolicy(tracking_file(tmp_path / "made.onnx"))


def torso(q: Floats) -> Floats:
    return turned(2, q[12]) @ turned(0, q[13]) @ turned(1, q[14])


def calm(count: int) -> list[tuple[RobotState, Floats]]:
    """States and commands of a robot that turns slowly, leans and bends."""
    return [(state, command * [1, 1, 1, 1, 1, 0.5, *[1] * 29]) for state, command in inputs(count)]


def test_observations_equal_the_facts_over_ten_steps(policy: HolosomaTrackingPolicy) -> None:
    action, before, heading = np.zeros(29, np.float32), None, 0.0
    for state, command in calm(10):
        roll, pitch, rate, joints = command[3], command[4], command[5], command[6:]
        robot, asked = of_root(state.quat_wxyz) @ torso(state.q), turned(1, pitch) @ turned(0, roll) @ torso(joints)
        if before is None:  # both begin where the robot looks
            heading, velocity = looks(robot) - looks(asked), np.zeros(29)
        else:
            climb = (pitch - before[4]) / 0.02
            heading += 0.02 * (rate + climb * np.sin(roll)) / (np.cos(pitch) * np.cos(roll))
            heading = np.clip(heading, looks(robot) - looks(asked) - 0.6, looks(robot) - looks(asked) + 0.6)
            velocity = (joints - before[6:]) / 0.02
        seen = robot.T @ turned(2, heading) @ asked
        observation = policy.observe(state, command)
        assert (observation.dtype, observation.shape) == (np.float32, (156,))
        expected = [action, state.gyro, state.q - DEFAULT, state.dq, joints, velocity]
        expected += [[seen[0, 0], seen[0, 1], seen[1, 0], seen[1, 1], seen[2, 0], seen[2, 1]], [heading, pitch]]
        np.testing.assert_allclose(observation, np.concatenate(expected), rtol=2e-5, atol=2e-5)
        action, before = policy.act(observation), command


def test_only_what_the_network_knows_reaches_it(policy: HolosomaTrackingPolicy) -> None:
    (state, command), *_ = calm(1)
    observation = policy.observe(state, command)
    action = policy.act(observation)
    observation[154:] = 9.0
    np.testing.assert_array_equal(policy.act(observation), action)


def test_a_reference_that_turns_on_stays_within_reach_of_a_robot_that_does_not(policy: HolosomaTrackingPolicy) -> None:
    (state, command), *_ = calm(1)
    command = np.zeros(35)
    command[5] = 3.0
    for _ in range(200):
        observation = policy.observe(state, command)
    seen = observation[148:154].reshape(3, 2)
    assert np.arctan2(seen[1, 0], seen[0, 0]) == pytest.approx(0.6, abs=0.1), "the torso leans a little"


def test_targets_are_scaled_as_the_training_was(tmp_path: Path, policy: HolosomaTrackingPolicy) -> None:
    action = np.linspace(-2.0, 2.0, 29).astype(np.float32)
    np.testing.assert_allclose(policy.targets(action, np.zeros(35)).q, DEFAULT + action)
    by_effort = HolosomaTrackingPolicy(tracking_file(tmp_path / "ppo.onnx", metadata(experiment_config=CONFIG)))
    np.testing.assert_allclose(by_effort.targets(action, np.zeros(35)).q, DEFAULT + 0.25 * EFFORT / KP * action)
    np.testing.assert_array_equal(by_effort.targets(action, np.zeros(35)).kp, KP)


@pytest.mark.parametrize("is_run", [False, True])
def test_it_goes_on_from_a_recorded_observation(tmp_path: Path, *, is_run: bool) -> None:
    one, other = (HolosomaTrackingPolicy(tracking_file(tmp_path / f"{name}.onnx")) for name in "ab")
    other.observe(*calm(1)[0])
    expect_goes_on(one, other, calm(6), is_run=is_run)


def test_reset_it_begins_where_the_robot_looks(policy: HolosomaTrackingPolicy) -> None:
    expect_forgets(policy, calm(5))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"dof_names": ["hip"]}, "is for other joints: ['hip']; expected the 29 of a G1 in Unitree's order"),
        ({"kp": [1.0]}, "expected 29 numbers each for kp and kd in its metadata"),
        ({"experiment_config": {"robot": {}}}, "its experiment_config does not say how actions are scaled; expected"),
        ({"experiment_config": 3}, "its experiment_config does not say how actions are scaled; expected"),
    ],
)
def test_a_file_that_does_not_say_what_it_is_for_is_refused_in_a_line(
    tmp_path: Path, change: dict[str, Any], told: str
) -> None:
    with pytest.raises(BadFile, match=r"^[^\n]*$") as caught:
        HolosomaTrackingPolicy(tracking_file(tmp_path / "made.onnx", metadata(**change)))
    assert told in str(caught.value)


def test_a_walking_policy_is_none_that_tracks_and_holds_no_clip(tmp_path: Path) -> None:
    path = walking_file(tmp_path / "walk.onnx", 100, 29, metadata())
    with pytest.raises(
        BadFile, match=r"expected one float input obs \[batch, 154\], the checkpoint has obs \[1, 100\]"
    ):
        HolosomaTrackingPolicy(path)
    with pytest.raises(BadFile, match="holds no clip; expected an input time_step and outputs joint_pos"):
        load(path)


def test_its_clip_is_read_whole_and_its_torso_is_where_the_file_says(tmp_path: Path) -> None:
    path = tracking_file(tmp_path / "made.onnx")
    clip = load(path)
    assert (clip.name, clip.fps, clip.duration_s) == ("made", 50.0, pytest.approx((ROWS - 1) / 50))
    assert clip.facts()["format"] == "onnx"
    q, position, quat = np.split(onnx_file._rows(path), [29, 32], axis=1)
    found = [clip.at(row / 50) for row in range(ROWS)]
    np.testing.assert_allclose([each.q for each in found], q, atol=1e-12)
    root_pos, root_quat = np.array([each.root_pos for each in found]), np.array([each.root_quat_wxyz for each in found])
    np.testing.assert_allclose(root_pos[0, :2], 0.0, atol=1e-12)
    assert roll_pitch_yaw(root_quat[0])[2] == pytest.approx(0.0, abs=1e-12), "it looks along X at first"
    index, poses = INDEX["torso"], forward(root_pos, root_quat, q)
    began = of_root(normalized(quat[0, [3, 0, 1, 2]]))
    back = poses.rotation[index][0] @ began.T  # from the file's world to ours
    for row in range(ROWS):
        there = of_root(normalized(quat[row, [3, 0, 1, 2]]))
        np.testing.assert_allclose(poses.rotation[index][row], back @ there, atol=1e-5)
        moved = poses.position[index][row] - poses.position[index][0]
        np.testing.assert_allclose(moved, back @ (position[row] - position[0]), atol=1e-5)
    np.testing.assert_allclose(poses.position[index][:, 2], position[:, 2], atol=1e-5)


def test_a_clip_with_a_number_that_is_none_is_refused(tmp_path: Path) -> None:
    table = np.zeros((ROWS, 29))
    table[4, 2] = np.nan
    with pytest.raises(BadFile, match="its clip holds numbers that are not finite"):
        load(tracking_file(tmp_path / "made.onnx", clip={"joint_pos": table}))


@pytest.mark.assets
def test_the_clips_of_the_published_files_are_one_dance(assets: Path) -> None:
    fastsac, ppo = (load(ZOO.format(name)) for name in ("fastsac", "ppo"))
    assert [round(clip.duration_s * 50) + 1 for clip in (fastsac, ppo)] == [6774, 6574]
    for time_s in (0.1, 20.0, 131.0):
        one, other = fastsac.at(time_s + 2.0), ppo.at(time_s)
        np.testing.assert_allclose(one.q, other.q, atol=1e-6)
        np.testing.assert_allclose(one.root_ang_vel[2], other.root_ang_vel[2], atol=1e-4)
        assert one.root_pos[2] == pytest.approx(other.root_pos[2], abs=1e-5)


@pytest.mark.assets
@pytest.mark.usefixtures("assets")
@pytest.mark.parametrize("file", ["fastsac", "ppo"])
def test_it_dances_the_first_seconds_of_its_own_clip(file: str) -> None:
    """The whole clip through the station is a proof (`tests/main_job/test_proof_motions.py`)."""
    rig = build(RigConfig(policy="holosoma-wbt", checkpoint=ZOO.format(file), robot_options={"physics_dt_s": 0.002}))
    clip = load(ZOO.format(file))
    found = rehearse(Beginning(clip, 6.0), rig.policy, rig.robot, rig.command_format)
    assert not found.fell
    assert (found.mean_joint_error_rad or 1.0) < 0.15


class Beginning:
    """The first seconds of a motion."""

    def __init__(self, motion: Motion, seconds: float) -> None:
        self.name, self.joint_names, self.fps = motion.name, motion.joint_names, motion.fps
        self.duration_s, self.at, self.facts = seconds, motion.at, motion.facts
