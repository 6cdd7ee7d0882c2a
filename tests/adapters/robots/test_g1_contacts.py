"""What of the built-in G1 touches what: on its feet, fallen, with its hands, and driven by TWIST2's checkpoint."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from adapters.policies.twist2 import DEFAULT_Q
from adapters.robots.g1.mujoco_g1 import START_Q, MujocoG1
from station import registry, rotations
from station.control.rig import RigConfig
from station.protocols import Floats
from station.rehearse import rehearse_all
from tests.adapters.robots.g1_models import DEX3, G1, SEEN, TOUCHES, both, compiled, held, posed, touching

MESHED = "twist2:g1/g1_sim2sim_29dof.xml"
MOTIONS = [f"twist2:motions/0807_yanjie_walk_00{number}.pkl" for number in range(1, 7)]


@both
@pytest.mark.parametrize("q", [START_Q, tuple(DEFAULT_Q)], ids=["start", "default"])
def test_no_part_touches_another_where_a_run_begins(path: Path, q: tuple[float, ...]) -> None:
    model = compiled(path)
    assert touching(model, posed(model, q)) == set()


@both
@pytest.mark.parametrize(
    ("arm", "expected"),
    [
        ((0.2, 0.0, -0.7, 1.3), {("left_wrist_yaw_link", "pelvis"), ("pelvis", "right_wrist_yaw_link")}),
        ((-0.1, -0.2, -0.2, 1.3), {("left_elbow_link", "torso_link"), ("right_elbow_link", "torso_link")}),
        ((-1.2, 0.2, -0.2, -1.0), {("left_wrist_yaw_link", "torso_link"), ("right_wrist_yaw_link", "torso_link")}),
        ((-0.4, -0.3, 0.1, 1.2), {("left_wrist_yaw_link", "right_wrist_yaw_link")}),
        ((-0.5, -0.4, -0.1, 1.1), {("left_elbow_link", "right_elbow_link")}),
        (
            (0.1, -0.1, 0.1, 1.1),
            {("left_hip_roll_link", "left_wrist_yaw_link"), ("right_hip_roll_link", "right_wrist_yaw_link")},
        ),
    ],
    ids=["pelvis", "torso", "head", "hands", "forearms", "thighs"],
)
def test_hands_and_forearms_meet_the_robot(path: Path, arm: tuple[float, ...], expected: set[tuple[str, str]]) -> None:
    q = np.array(START_Q)
    q[15:19], q[22:26] = arm, np.array(arm) * (1, -1, -1, 1)
    model = compiled(path)
    assert expected <= touching(model, posed(model, q))


@both
def test_whatever_way_it_lies_it_sinks_no_deeper_than_a_few_centimetres(path: Path) -> None:
    model = compiled(path)
    random = np.random.default_rng(5)
    for _ in range(300):
        quat = rotations.normalized(random.normal(size=4))
        data = posed(model, START_Q, np.array([0, 0, 3, *quat]))
        lowest = {group: min(bottom(model, data, g) for g in members(model, group)) for group in (SEEN, TOUCHES)}
        assert lowest[TOUCHES] - lowest[SEEN] < 0.04


def members(model: mujoco.MjModel, group: int) -> list[int]:
    return [int(g) for g in np.flatnonzero(model.geom_group == group)]


def bottom(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    """Height of the lowest point of a geom [m]."""
    slopes = np.abs(data.geom_xmat[geom].reshape(3, 3)[2])  # how much of the vertical lies along each of its axes
    size = model.geom_size[geom]
    kind = mujoco.mjtGeom(model.geom_type[geom])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        reach = slopes @ size
    elif kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        reach = np.linalg.norm(slopes * size)
    elif kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        reach = slopes[2] * size[1] + np.hypot(*slopes[:2]) * size[0]
    else:  # a capsule, or a sphere: one without length
        reach = slopes[2] * size[1] + size[0]
    return float(data.geom_xpos[geom][2] - reach)


@both
@pytest.mark.parametrize(
    ("rotation", "expected"),
    [
        ((0, 1.57, 0), "torso_link"),
        ((0, -1.57, 0), "pelvis"),
        ((-1.57, 0, 0), "left_shoulder_yaw_link"),
        ((1.57, 0, 0), "right_shoulder_yaw_link"),
    ],
    ids=["front", "back", "left", "right"],
)
def test_dropped_on_any_side_it_has_fallen_and_says_on_what(path: Path, rotation: Floats, expected: str) -> None:
    robot = MujocoG1(path, physics_dt_s=0.002)
    robot._data.qpos[2] = 0.5
    robot._data.qpos[3:7] = rotations.from_rotation_vector(np.array(rotation))
    for _ in range(25):
        robot.write(held(START_Q))
    fall = robot.fallen()
    assert fall is not None
    assert expected in fall.contacts
    assert not any(name.endswith("ankle_roll_link") for name in fall.contacts)


@both
def test_it_lands_on_its_feet_and_nothing_else_touches(path: Path) -> None:
    robot = MujocoG1(path, physics_dt_s=0.002)
    for _ in range(40):
        robot.write(held(START_Q))
        assert robot.fallen() is None
        assert touching(robot._model, robot._data) == set()
    assert robot.qpos[2] > 0.76


@both
def test_five_seconds_of_hard_targets_leave_the_simulation_whole(path: Path) -> None:
    robot = MujocoG1(path, physics_dt_s=0.002)
    random = np.random.default_rng(6)
    for _ in range(250):
        robot.write(held(np.array(START_Q) + random.normal(size=29) * 0.3))
    assert np.isfinite(robot._data.qpos).all()
    assert np.abs(robot._data.qvel).max() < 100
    assert not any(warning.number for warning in robot._data.warning)


@pytest.mark.assets
@both
def test_hands_pass_clear_of_the_body_in_all_six_motions(assets: Path, path: Path) -> None:
    model = compiled(path)
    for name in MOTIONS:
        motion = registry.find("loader", "motion")(name)
        for time_s in np.arange(0, motion.duration_s, 0.1):
            frame = motion.at(float(time_s))
            root = np.concatenate([frame.root_pos + np.array([0, 0, 1]), frame.root_quat_wxyz])
            assert touching(model, posed(model, frame.q, root)) == set(), (name, time_s)


@pytest.mark.assets
def test_twist2_tracks_as_well_as_with_the_meshed_robot(processes: None, assets: Path) -> None:
    assert_tracked_as_well(MOTIONS[3:4])  # the shortest; `tests/test_proof_rehearse.py` has all six


def assert_tracked_as_well(motions: list[str]) -> None:
    errors = {}
    for model in (str(G1), MESHED):
        results = rehearse_all(
            motions, RigConfig(policy="twist2", robot_options={"model": model, "physics_dt_s": 0.002}), jobs=2
        )
        assert not any(result.fell for result in results), results
        errors[model] = np.array([result.mean_joint_error_rad for result in results])
    np.testing.assert_array_less(errors[str(G1)], 1.1 * errors[MESHED])


@pytest.mark.assets
def test_twist2_walks_with_hands_that_it_does_not_know(processes: None, assets: Path) -> None:
    config = RigConfig(policy="twist2", robot_options={"model": str(DEX3), "physics_dt_s": 0.002})
    results = rehearse_all(MOTIONS[3:4], config, jobs=2)
    assert not any(result.fell for result in results), results
