"""The simulated G1: its torques, its start, its falls, its bad input."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from adapters.policies.twist2 import DEFAULT_Q, gains
from adapters.robots.g1.joints import G1_29
from adapters.robots.g1.mujoco_g1 import START_Q, MujocoG1
from adapters.robots.legged import mjcf, unitree
from station import assets
from station.errors import BadFile, ConfigError, StationError
from station.protocols import Fall, Floats, JointTargets, Robot, SimulatedRobot
from station.rotations import from_rotation_vector, multiply, rotation_vector
from tests.adapters.robots.g1_models import G1
from tests.adapters.robots.stock_loop import StockLoop
from tests.view.robots import tiny

_KP, _KD = gains(4.0, 0.2)

with_models_of_others = pytest.mark.parametrize(
    "model",
    [
        "builtin:g1.xml",
        pytest.param("twist2:g1/g1_sim2sim_29dof.xml", marks=pytest.mark.assets),  # meshes
        pytest.param("zoo:models/g1_29dof.xml", marks=pytest.mark.assets),  # torque motors
        pytest.param("zoo:models/g1_playground.xml", marks=pytest.mark.assets),  # position actuators, other limits
    ],
)


@pytest.fixture
def robot() -> MujocoG1:
    return MujocoG1(G1)


@with_models_of_others
@pytest.mark.parametrize("physics_dt_s", [0.001, 0.002])
def test_the_engine_servo_equals_the_stock_loop_over_ten_periods(model: str, physics_dt_s: float) -> None:
    robot = MujocoG1(assets.resolve(model), physics_dt_s=physics_dt_s)
    stock = StockLoop(unitree.G1, assets.resolve(model), robot, physics_dt_s)
    random = np.random.default_rng(3)
    for _ in range(10):
        targets = JointTargets(np.array(START_Q) + random.normal(size=29) * 0.1, _KP, _KD)
        robot.write(targets)
        stock.write(targets)
        stock.assert_equals(robot)


@with_models_of_others
@pytest.mark.parametrize("physics_dt_s", [0.001, 0.002])
def test_the_engine_servo_clips_and_changes_gains_as_the_stock_loop(model: str, physics_dt_s: float) -> None:
    robot = MujocoG1(assets.resolve(model), physics_dt_s=physics_dt_s)
    stock = StockLoop(unitree.G1, assets.resolve(model), robot, physics_dt_s)
    random = np.random.default_rng(4)
    for period in range(10):
        # Hard kicks make contacts in which rounding grows without bound: each period starts from one state.
        stock.follow(robot)
        targets = JointTargets(np.array(START_Q) + random.normal(size=29) * 0.5, _KP / (1 + period % 2), _KD)
        robot.write(targets)
        stock.write(targets)
        stock.assert_equals(robot)
    assert stock.clipped > 10


def test_it_is_a_robot_and_starts_at_rest_in_the_start_pose(robot: MujocoG1) -> None:
    assert isinstance(robot, Robot)
    assert robot.joint_names == G1_29
    state = robot.read()
    np.testing.assert_array_equal(state.q, START_Q)
    np.testing.assert_array_equal(state.root_pos, (0, 0, 0.793))
    np.testing.assert_array_equal(state.quat_wxyz, (1, 0, 0, 0))
    assert not state.dq.any()
    assert robot.fallen() is None


def test_a_state_does_not_change_after_it_was_read(robot: MujocoG1) -> None:
    state = robot.read()
    before = [state.q.copy(), state.dq.copy(), state.quat_wxyz.copy(), state.gyro.copy()]
    robot.write(JointTargets(DEFAULT_Q, _KP, _KD))
    for then, now in zip(before, [state.q, state.dq, state.quat_wxyz, state.gyro], strict=True):
        np.testing.assert_array_equal(then, now)


def test_one_write_advances_one_control_period() -> None:
    robot = MujocoG1(G1, physics_dt_s=0.002, control_dt_s=0.01)
    robot.write(JointTargets(DEFAULT_Q, _KP, _KD))
    assert robot.time_s == pytest.approx(0.01)


def test_the_gyro_is_the_angular_velocity_in_the_pelvis_frame() -> None:
    robot = MujocoG1(G1, physics_dt_s=0.001, control_dt_s=0.001)
    limp = JointTargets(DEFAULT_Q, np.zeros(29), np.zeros(29))
    for _ in range(150):
        robot.write(limp)
    before = robot.read()
    robot.write(limp)
    after = robot.read()
    turned = rotation_vector(multiply(before.quat_wxyz * [1, -1, -1, -1], after.quat_wxyz)) / 0.001
    assert np.linalg.norm(after.gyro) > 0.1
    np.testing.assert_allclose(after.gyro, turned, atol=1e-6)


def test_a_limp_robot_falls_and_the_fall_names_what_touches_the_ground(robot: MujocoG1) -> None:
    fall = _let_go(robot)
    assert fall is not None
    assert fall.contacts
    assert not any(name.endswith("ankle_roll_link") for name in fall.contacts)


def test_a_leaning_pelvis_is_a_fall_beyond_60_degrees_only(robot: MujocoG1) -> None:
    for degrees, is_fall in ((59.0, False), (61.0, True)):
        robot._data.qpos[2] = 3.0  # high above the ground, so that only the tilt counts
        robot._data.qpos[3:7] = from_rotation_vector(np.radians([0.0, degrees, 0.0]))
        mujoco.mj_forward(robot._model, robot._data)
        fall = robot.fallen()
        assert (fall is not None) == is_fall
    assert fall is not None
    assert fall.tilt_rad == pytest.approx(np.radians(61.0))


def test_a_push_is_a_step_in_velocity_in_the_world_wherever_the_robot_looks(robot: MujocoG1) -> None:
    assert isinstance(robot, SimulatedRobot)
    limp = JointTargets(DEFAULT_Q, np.zeros(29), np.zeros(29))
    moved = []
    for velocity in ((0.0, 0.0, 0.0), (0.3, -0.4, 0.0)):
        robot.reset()
        robot._data.qpos[2] = 3.0  # in the air, where nothing holds it
        robot._data.qpos[3:7] = from_rotation_vector(np.array([0.0, 0.0, 2.0]))
        robot.push(np.array(velocity))
        joints = robot.read().dq
        robot.write(limp)
        moved.append(robot.qpos[:3])
    assert not joints.any(), "the whole body moves off at once"
    np.testing.assert_allclose(moved[1] - moved[0], np.array([0.3, -0.4, 0.0]) * 0.02, atol=1e-6)


def test_the_speeds_of_the_joints_are_those_of_their_motors(robot: MujocoG1) -> None:
    speeds = dict(zip(robot.joint_names, robot.joint_speeds.tolist(), strict=True))
    assert speeds["left_knee"] == 20.0
    assert speeds["right_elbow"] == 37.0
    assert speeds["right_wrist_yaw"] == 22.0


def test_reset_puts_a_fallen_robot_back_on_its_feet(robot: MujocoG1) -> None:
    assert _let_go(robot) is not None
    robot.reset()
    assert robot.fallen() is None
    np.testing.assert_array_equal(robot.read().q, START_Q)
    assert robot.time_s == 0.0


def test_two_runs_from_the_start_are_the_same_bit_for_bit(robot: MujocoG1) -> None:
    runs: list[Floats] = []
    for _ in range(2):
        robot.reset()
        for step in range(20):
            robot.write(JointTargets(DEFAULT_Q + 0.1 * np.sin(step), _KP, _KD))
        runs.append(robot.qpos)
    np.testing.assert_array_equal(*runs)


def test_a_model_without_a_floor_gets_one(tmp_path: Path) -> None:
    text = G1.read_text()
    path = tmp_path / "floorless.xml"
    path.write_text("\n".join(line for line in text.splitlines() if 'type="plane"' not in line))
    robot = MujocoG1(path)
    for _ in range(25):
        robot.write(JointTargets(DEFAULT_Q, _KP, _KD))
    assert robot.qpos[2] > 0.7


def test_targets_that_are_not_finite_are_refused_and_nothing_moves(robot: MujocoG1) -> None:
    with pytest.raises(ValueError, match="finite"):
        robot.write(JointTargets(np.full(29, np.nan), _KP, _KD))
    assert robot.time_s == 0.0


def test_the_facts_name_the_model_its_hash_and_the_time_steps(robot: MujocoG1) -> None:
    facts = robot.facts()
    assert facts["model"] == str(G1)
    assert len(facts["model_sha256"]) == 64
    assert (facts["physics_dt_s"], facts["control_dt_s"]) == (0.001, 0.02)
    assert facts["mass_kg"] == pytest.approx(33.34, abs=0.01)
    assert facts["has_hands"] is False
    assert MujocoG1(assets.resolve("builtin:g1_dex3.xml")).facts()["has_hands"] is True


@pytest.mark.parametrize("physics_dt_s", [0.0, -0.001, 0.003, 0.05, float("nan")])
def test_a_physics_step_that_does_not_fit_the_control_period_is_refused(physics_dt_s: float) -> None:
    with pytest.raises(ConfigError, match="whole number of times"):
        MujocoG1(G1, physics_dt_s=physics_dt_s)


def test_a_model_of_another_robot_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(BadFile, match="expected the 29 joints of a Unitree G1") as caught:
        MujocoG1(tiny(tmp_path))
    assert "\n" not in str(caught.value)


def test_a_viewer_without_a_display_is_refused_and_the_process_lives(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(StationError, match="no display can be opened"):
        MujocoG1(G1, viewer=True)


@with_models_of_others
def test_the_motion_is_the_same_to_the_last_bit_without_what_is_only_seen(model: str) -> None:
    """A robot staggers and falls under random torques."""
    path, ends = assets.resolve(model), []
    drawn, unseen = (mjcf.load(unitree.G1, path, is_drawn=is_drawn) for is_drawn in (True, False))
    for each in (drawn, unseen):
        data, random = mujoco.MjData(each), np.random.default_rng(5)
        for _ in range(400):
            data.qfrc_applied[6:] = random.normal(0.0, 5.0, each.nv - 6)
            mujoco.mj_step(each, data, 2)
        touching = {each.body(body).name for body in each.geom_bodyid[data.contact.geom].ravel()}
        ends.append((data.qpos.tobytes(), data.qvel.tobytes(), touching))
    assert ends[0] == ends[1]
    assert len(ends[0][2]) >= 3, "it stands on the ground, or lies there"
    if model.startswith("twist2"):
        assert (unseen.ngeom, unseen.nmeshvert) < (drawn.ngeom, 0.6 * drawn.nmeshvert)


def _let_go(robot: MujocoG1) -> Fall | None:
    limp = JointTargets(DEFAULT_Q, np.zeros(29), np.full(29, 0.2))
    for _ in range(150):
        robot.write(limp)
        if robot.fallen() is not None:
            break
    return robot.fallen()
