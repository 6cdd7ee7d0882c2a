"""Any robot on legs in MuJoCo: its torques, its start and its falls, what comes late, what its model lacks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import mujoco
import numpy as np
import pytest

from adapters.robots.legged import kind
from adapters.robots.legged.command import PoseCommand
from adapters.robots.legged.mujoco_robot import LeggedMujoco
from adapters.robots.legged.table import LeggedRobot
from adapters.robots.legged.unitree import GO1, GO2, H1, ROBOTS
from station import assets, registry
from station.control.rig import RigConfig, build
from station.errors import BadFile, ConfigError
from station.protocols import JointTargets, Robot, SimulatedRobot
from tests.adapters.robots.stock_loop import StockLoop

each = pytest.mark.parametrize("robot", ROBOTS.values(), ids=lambda robot: robot.name)


def simulated(robot: LeggedRobot, **settings: object) -> LeggedMujoco:
    return LeggedMujoco(robot, assets.resolve(robot.mjcf), **settings)


def stand(robot: LeggedRobot, q: object = None) -> JointTargets:
    """What holds it as it stands, or its joints elsewhere [rad]."""
    return JointTargets(np.array(robot.start_q if q is None else q), np.array(robot.stand_kp), np.array(robot.stand_kd))


@each
def test_its_torques_are_kp_times_error_less_kd_times_speed_clipped_in_every_physics_step(robot: LeggedRobot) -> None:
    simulation = simulated(robot)
    stock = StockLoop(robot, assets.resolve(robot.mjcf), simulation, 0.002)
    random = np.random.default_rng(3)
    for period in range(6):
        stock.follow(simulation)  # in hard contacts rounding grows without bound: each period starts from one state
        lower, upper = ([getattr(joint, end) for joint in robot.joints] for end in ("lower", "upper"))
        targets = stand(robot, np.clip(robot.start_q + random.normal(size=len(robot.joints)), lower, upper))
        targets = JointTargets(targets.q, targets.kp / (1 + period % 2), targets.kd)
        assert simulation.write(targets) is targets
        stock.write(targets)
        stock.assert_equals(simulation)
    assert stock.clipped > 10


@each
def test_it_starts_at_rest_on_its_feet_and_says_what_it_is(robot: LeggedRobot) -> None:
    simulation = simulated(robot)
    assert isinstance(simulation, Robot)
    assert isinstance(simulation, SimulatedRobot)
    state = simulation.read()
    assert simulation.joint_names == robot.joint_names
    np.testing.assert_array_equal(state.q, robot.start_q)
    np.testing.assert_array_equal(state.root_pos, (0, 0, robot.start_height_m))
    assert not state.dq.any()
    assert simulation.fallen() is None
    np.testing.assert_array_equal(simulation.joint_speeds, [joint.velocity_rad_s for joint in robot.joints])
    facts = simulation.facts()
    assert facts["model_sha256"] == assets.sha256(assets.resolve(robot.mjcf))
    assert (facts["latency_steps"], facts["physics_dt_s"], facts["control_dt_s"]) == (0, 0.002, 0.02)
    np.testing.assert_allclose(facts["armature"], [joint.armature for joint in robot.joints])
    assert simulation._data.ncon == 0, "it starts a little above the ground"
    simulation.write(stand(robot))
    for _ in range(10):
        simulation.write(stand(robot))
    assert simulation._data.ncon >= 4, "and is put down at once"


@each
def test_without_a_network_and_without_a_commander_it_stands_for_ten_seconds(
    processes: None, robot: LeggedRobot
) -> None:
    rig = build(RigConfig(robot=f"{robot.name.replace('_', '-')}-mujoco"))
    control = rig.control()
    for step in range(500):
        record = control.step(control.sense(), None, step * 0.02)
        assert record.fall is None, f"after {step * 0.02:.1f} s"
    now = rig.robot.read()
    assert np.abs(now.q - robot.start_q).max() < 0.15
    assert np.abs(now.dq).max() < 0.1
    assert now.quat_wxyz[0] > 0.995
    assert now.root_pos[2] == pytest.approx(robot.start_height_m, abs=0.03)


@each
def test_it_withstands_the_pushes_that_the_docs_promise(processes: None, robot: LeggedRobot) -> None:
    simulation = simulated(robot)
    push_m_s = {"go2": 0.8, "go1": 0.5, "g1_12": 0.2, "g1_23": 0.2}.get(robot.name, 0.3)
    for direction in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)):
        simulation.reset()
        for step in range(150):
            if step == 50:
                simulation.push(push_m_s * np.array(direction))
            simulation.write(stand(robot))
            assert simulation.fallen() is None, direction


@each
def test_limp_it_falls_and_what_touches_the_ground_is_named(robot: LeggedRobot) -> None:
    simulation = simulated(robot)
    limp = JointTargets(np.array(robot.start_q), np.zeros(len(robot.joints)), np.full(len(robot.joints), 0.2))
    for _ in range(200):
        simulation.write(limp)
        if (fall := simulation.fallen()) is not None:
            break
    assert fall is not None
    assert fall.contacts
    assert not any(name.endswith(robot.feet) for name in fall.contacts)
    simulation.reset()
    assert simulation.fallen() is None


def test_with_a_latency_of_a_step_it_moves_as_one_that_is_told_a_step_later() -> None:
    late, prompt = simulated(GO2, latency_steps=1), simulated(GO2)
    random = np.random.default_rng(5)
    told = [stand(GO2, GO2.start_q + random.normal(size=12) * 0.1) for _ in range(20)]
    for sent, before in zip(told, [stand(GO2), *told], strict=False):
        assert late.write(sent) is sent, "what was sent, not what arrived"
        prompt.write(before)
        np.testing.assert_array_equal(late.qpos, prompt.qpos)
    late.reset()
    late.write(told[0])
    prompt.reset()
    prompt.write(stand(GO2))
    np.testing.assert_array_equal(late.qpos, prompt.qpos, err_msg="a reset forgets what was on the way")


def test_what_was_on_its_way_when_it_was_disarmed_moves_nothing_when_it_is_armed_again() -> None:
    late, prompt = simulated(GO2, latency_steps=1), simulated(GO2)
    for robot in (late, prompt):
        robot.write(stand(GO2))
    late.write(stand(GO2, np.array(GO2.start_q) + 0.3))
    prompt.write(stand(GO2))
    np.testing.assert_array_equal(late.qpos, prompt.qpos)
    late.damp()
    now = late.read().q
    late.write(stand(GO2))
    prompt.write(stand(GO2, now))
    np.testing.assert_array_equal(late.qpos, prompt.qpos, err_msg="it is held where it is until targets arrive")


@pytest.mark.parametrize(("rows", "expected"), [("", [0.01] * 12), ('armature="0.03"', [0.03] * 12)])
def test_rotor_inertia_that_a_model_lacks_is_the_tables(tmp_path: Path, rows: str, expected: list[float]) -> None:
    text = assets.resolve(GO2.mjcf).read_text().replace('armature="0.1"', rows)
    path = tmp_path / "go2.xml"
    path.write_text(text)
    robot = replace(GO2, joints=tuple(replace(joint, armature=0.01) for joint in GO2.joints))
    assert LeggedMujoco(robot, path).facts()["armature"] == pytest.approx(expected)
    assert LeggedMujoco(robot, path, armature=0.2).facts()["armature"] == pytest.approx([0.2] * 12)
    assert LeggedMujoco(replace(robot, fills_armature=False), path).facts()["armature"] == pytest.approx(
        [0.0] * 12 if not rows else expected
    )


def test_a_root_near_the_ground_has_fallen_though_nothing_of_it_can_touch(tmp_path: Path) -> None:
    text = assets.resolve(H1.mjcf).read_text()
    path = tmp_path / "h1.xml"
    path.write_text("\n".join(line for line in text.splitlines() if 'class="limb"' not in line or "<default" in line))
    simulation = LeggedMujoco(H1, path)
    for height_m, fallen in ((0.51, False), (0.49, True)):
        simulation._data.qpos[2] = height_m
        simulation._data.qpos[7:] = 0
        mujoco.mj_forward(simulation._model, simulation._data)
        fall = simulation.fallen()
        assert (fall is not None) == fallen
    assert fall is not None
    assert fall.contacts == ("pelvis",)


def test_joints_may_go_without_their_ending_in_a_model(tmp_path: Path) -> None:
    path = tmp_path / "h1.xml"
    path.write_text(assets.resolve(H1.mjcf).read_text().replace('_joint"', '"'))
    simulation, same = LeggedMujoco(H1, path), simulated(H1)
    for robot in (simulation, same):
        robot.write(stand(H1))
    np.testing.assert_array_equal(simulation.qpos, same.qpos)


def test_a_model_of_another_robot_is_refused_in_a_line() -> None:
    with pytest.raises(BadFile, match="expected the 19 joints of a Unitree H1, 19 are missing: left_hip_yaw_joint, "):
        LeggedMujoco(H1, assets.resolve(GO2.mjcf))
    with pytest.raises(BadFile, match="expected one free joint, that of the trunk; came 1"):
        LeggedMujoco(GO1, assets.resolve(GO2.mjcf))


@pytest.mark.assets
@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("go2", "go2"),
        ("go1", "go1_playground"),
        ("h1_10", "h1_10dof"),
        ("h1_2_12", "h1_2_12dof"),
        ("g1_12", "g1_12dof"),
    ],
)
def test_upstreams_model_of_it_stands_as_well(name: str, model: str) -> None:
    robot = ROBOTS[name]
    simulation = LeggedMujoco(robot, assets.resolve(f"zoo:models/{model}.xml"))
    for _ in range(150):
        simulation.write(stand(robot))
        assert simulation.fallen() is None
    assert np.abs(simulation.read().q - robot.start_q).max() < 0.15


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"latency_steps": -1}, "latency_steps is -1; expected 0 to 10"),
        ({"armature": -0.1}, "armature is -0.1 kg m^2; expected 0, for the model's, to 10"),
        ({"latency": 1}, "unknown key 'latency'"),
    ],
)
def test_a_setting_that_cannot_be_is_refused_in_a_line(options: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said.replace("^", r"\^")):
        kind.GO2.typed(options)


def test_each_is_registered_with_a_command_of_its_joints_and_describes_itself() -> None:
    for name, robot in ROBOTS.items():
        short = name.replace("_", "-")
        found = registry.find("robot", f"{short}-mujoco")
        command = registry.find("command", f"{short}-joints")
        described = found.describe(command)
        assert (described.name, described.model) == (name, robot.model)
        assert described.joint_names == robot.joint_names
        assert assets.resolve(described.drawn_as).is_file()
        keys = {item.key: item for item in described.contracts()}
        assert keys[f"action_joints_{name}"].names == tuple(f"{joint}_pos" for joint in robot.joint_names)
        assert len(keys[f"command_used_{name}"].elements) == len(robot.joints)
        msgspec.json.encode(described)


def test_a_pose_goes_by_names_and_a_motion_of_another_body_has_it_stand() -> None:
    g1 = registry.find("loader", "motion")("builtin:wave")
    reference = g1.at(2.0)
    for name, robot in ROBOTS.items():
        asked = PoseCommand.of(robot).encode(reference, g1.joint_names)
        if name in ("g1_12", "g1_23"):  # a motion says nothing of hands
            by_name = dict(zip(g1.joint_names, reference.q, strict=True))
            np.testing.assert_array_equal(asked, [by_name[joint] for joint in robot.joint_names])
        else:
            np.testing.assert_array_equal(asked, robot.start_q)
