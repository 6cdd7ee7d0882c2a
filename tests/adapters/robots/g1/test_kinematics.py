"""Kinematics in numpy, against the physics engine."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from adapters.robots.g1 import joints, kinematics
from adapters.robots.g1.joints import G1_29
from station import rotations

MODEL = Path(kinematics.__file__).with_name("g1.xml")
FRAMES = 40


@pytest.fixture(scope="module")
def poses() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random poses over the whole ranges of the joints."""
    rng = np.random.default_rng(3)
    root_pos = rng.normal(size=(FRAMES, 3))
    root_quat = rotations.normalized(rng.normal(size=(FRAMES, 4)))
    q = rng.uniform(joints.lower(G1_29), joints.upper(G1_29), (FRAMES, len(G1_29)))
    return root_pos, root_quat, q


def test_every_link_and_the_centre_of_mass_are_where_the_engine_has_them(
    poses: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    model = mujoco.MjModel.from_xml_path(str(MODEL))
    data = mujoco.MjData(model)
    columns = [model.joint(f"{name}_joint").qposadr[0] for name in G1_29]
    links = kinematics.forward(*poses)
    com = links.centre_of_mass()
    for frame, (root_pos, root_quat, q) in enumerate(zip(*poses, strict=True)):
        data.qpos[:7], data.qpos[columns] = (*root_pos, *root_quat), q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for index, link in enumerate(kinematics.LINKS):
            body = data.body("pelvis" if index == 0 else f"{link.name}_link")
            np.testing.assert_allclose(links.position[index, frame], body.xpos, atol=1e-6)
            np.testing.assert_allclose(links.rotation[index, frame], body.xmat.reshape(3, 3), atol=1e-5)
        np.testing.assert_allclose(com[frame], data.subtree_com[0], atol=1e-4)


def test_each_joint_turns_the_link_of_its_place_about_its_axis() -> None:
    moved = [link.name.replace("torso", "waist_pitch") for link in kinematics.LINKS[1:]]
    assert tuple(moved) == G1_29
    assert [link.axis for link in kinematics.LINKS[1:]] == [joint.axis for joint in joints.JOINTS]


def test_the_mass_is_that_of_the_robot() -> None:
    assert pytest.approx(33.341, abs=1e-3) == kinematics.TOTAL_MASS_KG


def test_points_of_a_link_go_with_it(poses: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    links = kinematics.forward(*poses)
    soles = links.points("left_ankle_roll", kinematics.SOLE_POINTS)
    assert soles.shape == (FRAMES, 4, 3)
    index = kinematics.INDEX["left_ankle_roll"]
    expected = links.position[index, 7] + links.rotation[index, 7] @ kinematics.SOLE_POINTS[2]
    np.testing.assert_allclose(soles[7, 2], expected, atol=1e-12)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_turn_about_an_axis_is_that_of_the_quaternion(axis: str) -> None:
    angles = np.linspace(-3.0, 3.0, 7)
    vectors = angles[:, None] * np.eye(3)["xyz".index(axis)]
    expected = kinematics.matrix(rotations.from_rotation_vector(vectors))
    np.testing.assert_allclose(kinematics.about(axis, angles), expected, atol=1e-12)


def test_soles_are_where_the_kinematics_of_the_whole_robot_have_them() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        quat, q = rng.normal(size=4), rng.uniform(-1.0, 1.0, 29)
        quat /= np.linalg.norm(quat)
        links = kinematics.forward(np.zeros((1, 3)), quat[None], q[None])
        feet = [links.points(f"{side}_ankle_roll", kinematics.SOLE_POINTS)[0] for side in ("left", "right")]
        assert kinematics.soles(quat, q[:12]) == pytest.approx(np.concatenate(feet), abs=1e-12)
