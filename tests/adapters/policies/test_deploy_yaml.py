"""Policies that a ``deploy.yaml`` describes: their layout, from synthetic pages, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from adapters.policies.deploy_yaml import DeployYamlPolicy
from adapters.robots.g1.joints import G1_29
from adapters.robots.legged.unitree import ROBOTS
from station.control.parted_path import samples_of
from station.control.rig import RigConfig, build
from station.errors import BadFile, ConfigError, StationError
from station.protocols import Floats
from tests.adapters.policies.restored import expect_forgets, expect_goes_on

from .velocity_inputs import gravity, inputs, onnx_file

MAP = [3, 0, 9, 6, 4, 1, 10, 7, 5, 2, 11, 8]
"""The motor of each joint of the network, as for a Go2: not its own inverse."""
MOTORS = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]
"""The motor of each joint of a Go2, whose model begins with the left leg and whose messages with the right one."""
JOINT = [MOTORS.index(motor) for motor in MAP]
"""The Go2's joint of each joint of the network."""
DEFAULT = np.linspace(-1.5, 0.9, 12)
SCALES = {
    "base_ang_vel": [0.2, 0.3, 0.4],
    "projected_gravity": None,
    "velocity_commands": [2.0, 1.0, 0.25],
    "joint_pos_rel": [1.0 + index / 10 for index in range(12)],
    "joint_vel_rel": [0.05] * 12,
    "last_action": [1.0] * 12,
}
STEPS = {"base_ang_vel": 3, "projected_gravity": 1, "velocity_commands": 0, "joint_vel_rel": 5, "last_action": 2}
SIZE = 3 * (3 + 1 + 1) + 12 * (1 + 5 + 2)


def page(**changes: Any) -> dict[str, Any]:
    """What a page says, but for what is given."""
    terms = {name: {"params": {}, "clip": None, "scale": scale} for name, scale in SCALES.items()}
    for name, steps in STEPS.items():
        terms[name]["history_length"] = steps
    terms["base_ang_vel"]["clip"] = [-1.0, 1.5]
    action = {
        "clip": [[-2.0, 2.0]] * 6 + [[-0.5, 0.6]] * 6, "joint_names": [".*"],
        "scale": [0.25] * 6 + [0.5] * 6, "offset": (DEFAULT + 0.1).tolist(), "joint_ids": None,
    }  # fmt: skip
    return {
        "joint_ids_map": MAP, "step_dt": 0.025, "stiffness": [20.0 + motor for motor in range(12)],
        "damping": [0.5 + motor / 10 for motor in range(12)], "default_joint_pos": DEFAULT.tolist(),
        "commands": {"base_velocity": {"ranges": {"lin_vel_x": [-0.5, 1], "lin_vel_y": [-0.3, 0.4],
                                                  "ang_vel_z": [-0.2, 0.2], "heading": None}}},
        "actions": {"JointPositionAction": action}, "observations": terms,
    } | changes  # fmt: skip


def write(folder: Path, facts: object, *, inputs: int = SIZE, outputs: int = 12) -> Path:
    """Write a page with a network beside it."""
    onnx_file(folder / "policy.onnx", inputs, outputs)
    path = folder / "deploy.yaml"
    path.write_text(facts if isinstance(facts, str) else yaml.safe_dump(facts, sort_keys=False))
    return path


@pytest.fixture
def policy(tmp_path: Path) -> DeployYamlPolicy:
    return DeployYamlPolicy(write(tmp_path, page()))


def test_observations_equal_the_facts_over_thirty_steps(policy: DeployYamlPolicy) -> None:
    """Written out joint by joint: a network's joint i is the robot's joint JOINT[i]."""
    action, seen = np.zeros(12, np.float32), []
    for state, command in inputs(30, 12):
        q = [(state.q[JOINT[i]] - DEFAULT[i]) * (1.0 + i / 10) for i in range(12)]
        dq = [state.dq[JOINT[i]] * 0.05 for i in range(12)]
        gyro = [min(max(state.gyro[axis], -1.0), 1.5) * SCALES["base_ang_vel"][axis] for axis in range(3)]
        seen.append((gyro, gravity(state.quat_wxyz), command * [2.0, 1.0, 0.25], q, dq, action.astype(np.float64)))
        expected: list[Floats] = []
        for number, steps in enumerate((3, 1, 1, 1, 5, 2)):
            shown = [seen[0][number]] * steps + [step[number] for step in seen]  # the first stands for those before it
            expected += [np.array(one) for one in shown[-steps:]]
        observation = policy.observe(state, command)
        assert observation.dtype == np.float32
        np.testing.assert_allclose(observation, np.concatenate(expected).astype(np.float32), rtol=0, atol=1e-6)
        action = policy.act(observation)


def test_targets_are_scaled_moved_clipped_and_given_to_their_motors(policy: DeployYamlPolicy) -> None:
    action = np.linspace(-9, 9, 12).astype(np.float32)
    targets = policy.targets(action, np.zeros(3))
    for of_network, joint in enumerate(JOINT):
        scale, lower, upper = (0.25, -2.0, 2.0) if of_network < 6 else (0.5, -0.5, 0.6)
        wanted = min(max(float(action[of_network]) * scale + DEFAULT[of_network] + 0.1, lower), upper)
        assert targets.q[joint] == pytest.approx(wanted, abs=1e-12)
    np.testing.assert_array_equal(targets.kp, [20.0 + motor for motor in MOTORS])
    np.testing.assert_array_equal(targets.kd, [0.5 + motor / 10 for motor in MOTORS])


@pytest.mark.parametrize("is_run", [True, False])
def test_a_restored_policy_goes_on_bit_for_bit(policy: DeployYamlPolicy, is_run: bool) -> None:
    other = DeployYamlPolicy(policy.spec.checkpoint)
    expect_goes_on(policy, other, inputs(20, 12, seed=1), is_run=is_run)


def test_reset_forgets_everything(policy: DeployYamlPolicy) -> None:
    expect_forgets(policy, inputs(4, 12))


def test_its_constants(policy: DeployYamlPolicy) -> None:
    spec = policy.spec
    assert (spec.name, spec.command, spec.rate_hz) == ("deploy-yaml", "velocity", 40.0)
    assert (spec.observation_size, spec.action_size) == (SIZE, 12)
    assert spec.joint_names == ROBOTS["go2"].joint_names
    assert [spec.default_q[joint] for joint in JOINT] == DEFAULT.tolist()
    assert spec.command_lower is not None
    assert spec.command_upper is not None
    assert (spec.command_lower.tolist(), spec.command_upper.tolist()) == ([-0.5, -0.3, -0.2], [1.0, 0.4, 0.2])


def test_its_hash_is_that_of_page_network_and_weights(tmp_path: Path) -> None:
    path = write(tmp_path, page())
    hashes = [DeployYamlPolicy(path).spec.sha256]
    (tmp_path / "policy.onnx.data").write_bytes(b"weights")
    hashes.append(DeployYamlPolicy(path).spec.sha256)
    path.write_text(path.read_text() + "\n")
    hashes.append(DeployYamlPolicy(path).spec.sha256)
    onnx_file(tmp_path / "policy.onnx", SIZE, 12, scale=0.2)
    hashes.append(DeployYamlPolicy(path).spec.sha256)
    assert len(set(hashes)) == 4
    assert DeployYamlPolicy(path).spec.sha256 == hashes[-1]


@pytest.mark.parametrize(
    ("at", "network"),
    [("params/deploy.yaml", "exported/policy.onnx"), ("deploy.yaml", "policy.onnx"), ("walk.yaml", "walk.onnx")],
)
def test_a_network_is_found_where_exporters_put_it(tmp_path: Path, at: str, network: str) -> None:
    for name in (at, network):
        (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / at).write_text(yaml.safe_dump(page(), sort_keys=False))
    onnx_file(tmp_path / network, SIZE, 12)
    assert DeployYamlPolicy(tmp_path / at).spec.action_size == 12


def test_a_robot_of_the_same_motors_is_named_and_one_of_others_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, page())
    assert DeployYamlPolicy(path, robot="go1").spec.joint_names == ROBOTS["go1"].joint_names
    with pytest.raises(
        ConfigError, match=r"robot 'go11' is not known \(did you mean 'go1'\?\); known: g1_29, go2, go1"
    ):
        DeployYamlPolicy(path, robot="go11")
    with pytest.raises(
        ConfigError, match=r"joint_ids_map: motors \[3, .*; robot 'g1_29' has \[0, 1, .*28\]; known: g1"
    ):
        DeployYamlPolicy(path, robot="g1_29")
    with pytest.raises(
        ConfigError, match=r"joint_ids_map: motors \[0, 1, 2\]; no robot that is known has these; known"
    ):
        DeployYamlPolicy(write(tmp_path, page(joint_ids_map=[0, 1, 2])))


def test_a_robot_whose_messages_have_a_slot_without_a_motor_has_gains_for_that_too(tmp_path: Path) -> None:
    motors = ROBOTS["h1"].motors
    terms = {"joint_pos_rel": {"scale": [1.0] * 19}, "last_action": {"scale": [1.0] * 19}}
    facts = page(
        joint_ids_map=sorted(motors), stiffness=[100.0 + slot for slot in range(20)], damping=[1.0] * 20,
        default_joint_pos=[0.0] * 19, observations=terms, actions={"JointPositionAction": {"scale": [0.25] * 19}},
    )  # fmt: skip
    spec = DeployYamlPolicy(write(tmp_path, facts, inputs=38, outputs=19)).spec
    assert spec.joint_names == ROBOTS["h1"].joint_names
    assert spec.kp.tolist() == [100.0 + motor for motor in motors]


def test_a_dog_stands_by_its_page_on_the_robot_that_it_is_for(tmp_path: Path) -> None:
    default = [ROBOTS["go2"].start_q[joint] for joint in JOINT]
    facts = page(default_joint_pos=default, stiffness=[60.0] * 12, damping=[3.0] * 12, step_dt=0.02)
    facts["actions"]["JointPositionAction"] |= {"offset": default, "clip": None}
    path = write(tmp_path, facts)
    onnx_file(tmp_path / "policy.onnx", SIZE, 12, scale=0.0)
    rig = build(RigConfig(robot="go2-mujoco", policy="deploy-yaml", checkpoint=str(path)))
    control = rig.control()
    for tick in range(80):
        record = control.step(control.sense(), samples_of(rig.command_format, np.zeros(3), tick * 0.02), tick * 0.02)
    assert record.fall is None
    np.testing.assert_allclose(record.state.q, ROBOTS["go2"].start_q, rtol=0, atol=0.1)


def test_a_tag_of_python_s_slice_means_all_joints_and_any_other_is_refused(tmp_path: Path) -> None:
    text = yaml.safe_dump(page(), sort_keys=False)
    tagged = text.replace("joint_ids: null", "joint_ids: !!python/object/apply:builtins.slice [null, null, null]")
    assert tagged != text
    assert DeployYamlPolicy(write(tmp_path, tagged)).spec.action_size == 12
    evil = text.replace("joint_ids: null", "joint_ids: !!python/object/apply:os.system [touch here]")
    with pytest.raises(BadFile, match=r"no deploy\.yaml"):
        DeployYamlPolicy(write(tmp_path, evil))
    assert not (tmp_path / "here").exists()


def _with(term: str, **changes: Any) -> dict[str, Any]:
    facts = page()
    return facts | {"observations": facts["observations"] | {term: facts["observations"].get(term, {}) | changes}}


def _acting(**changes: Any) -> dict[str, Any]:
    action = page()["actions"]["JointPositionAction"]
    return page(actions={"JointPositionAction": action | changes})


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        ("[1, 2]", "no deploy.yaml of a policy that follows velocities: Expected `object`, got `array`"),
        ("a: [", "not YAML"),
        (page(joint_ids_map=[0] * 12), r"joint_ids_map: motors \[0, .*; no robot that is known has these"),
        (page(stiffness=[1.0] * 11), "stiffness: expected 12 finite numbers"),
        (page(damping=[1.0] * 11 + [float("nan")]), "damping: expected 12 finite numbers"),
        (page(step_dt=0), r"> 0.0.* at `\$.step_dt`"),
        (page(commands={}), "missing required field `base_velocity`"),
        (page(actions={"JointVelocityAction": {}}), "unknown field `JointVelocityAction`"),
        (_acting(joint_ids=[0, 1]), r"joint_ids \[0, 1\]; expected all joints"),
        (_acting(clip=[[0, 1]]), r"clip: expected 12 pairs of numbers, got \[\(0.0, 1.0\)\]"),
        (_acting(clip=[[0, float("nan")]] * 12), r"clip: expected 12 pairs of numbers, got \[\(0.0, nan\), "),
        (_acting(offset=[0.0]), "offset: expected 12 finite numbers"),
        (_with("gait_phase"), "observation 'gait_phase' is not known here; known: base_ang_vel"),
        (_with("base_ang_vel", scale=[1.0]), "base_ang_vel: scale: expected 3 finite numbers"),
        (_with("base_ang_vel", history_length=101), "history_length"),
        (_with("base_ang_vel", history_length=4), rf"\[batch, {SIZE + 3}\]"),
    ],
)
def test_a_page_of_another_kind_is_refused_in_one_line(tmp_path: Path, facts: object, words: str) -> None:
    path = write(tmp_path, facts)
    with pytest.raises(StationError, match=words) as caught:
        DeployYamlPolicy(path)
    assert str(path.parent) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_page_or_a_network_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(BadFile, match=r"no such file; expected a deploy\.yaml"):
        DeployYamlPolicy(tmp_path / "deploy.yaml")
    path = write(tmp_path, page())
    with pytest.raises(BadFile, match=r"is no text; name the deploy\.yaml that belongs to the network"):
        DeployYamlPolicy(tmp_path / "policy.onnx")
    (tmp_path / "policy.onnx").unlink()
    with pytest.raises(BadFile, match=r"expected policy.onnx, deploy.onnx or ../exported/policy.onnx beside it"):
        DeployYamlPolicy(path)


@pytest.mark.assets
@pytest.mark.parametrize(
    ("page", "numbers"), [("unitree_rl_lab_g1.yaml", 480), ("unitree_rl_mjlab_g1/deploy.yaml", 96)]
)
def test_the_pages_of_a_g1(assets: Path, page: str, numbers: int) -> None:
    spec = DeployYamlPolicy(assets / "zoo/policies" / page).spec
    assert (spec.observation_size, spec.action_size, spec.joint_names) == (numbers, 29, G1_29)
    knee = G1_29.index("left_knee")
    assert spec.default_q[knee] == pytest.approx(0.3)
    assert spec.kp[knee] == pytest.approx(max(spec.kp[:12]), rel=0.01)
