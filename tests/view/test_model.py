"""The robot of a viewer: shapes of every kind, and bodies where forward kinematics puts them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.robots.g1.joints import G1_29
from adapters.robots.kassow.names import ARM_7
from station import assets
from station.errors import BadFile
from station.view.model import RobotModel
from station.view.shapes import Mesh, clustered
from tests.view.robots import tiny


@pytest.fixture
def model(tmp_path: Path) -> RobotModel:
    return RobotModel(tiny(tmp_path))


def test_every_kind_of_shape_is_found_and_the_floor_is_none(model: RobotModel) -> None:
    kinds = {(shape.body, shape.kind) for shape in model.shapes}
    assert kinds == {
        ("pelvis", "box"), ("left_hip", "capsule"), ("left_knee", "mesh"), ("head", "ellipsoid"),
    }  # fmt: skip
    assert model.visible == {"pelvis", "left_hip", "left_knee", "head"}


def test_body_with_visual_geometry_shows_that_alone(model: RobotModel) -> None:
    assert [shape.kind for shape in model.shapes if shape.body == "left_knee"] == ["mesh"]


def test_bodies_are_where_root_and_joints_put_them(model: RobotModel) -> None:
    root = np.array([[1.0, 2.0, 0.8, 1, 0, 0, 0], [1.0, 2.0, 0.8, np.sqrt(0.5), 0, 0, np.sqrt(0.5)]])
    q = np.array([[0.0, 9.9], [np.pi / 2, 9.9]])
    positions, quats = model.poses(root, ["left_hip_pitch", "no_such_joint"], q)
    knee = model.bodies.index("left_knee")
    assert positions[0, knee] == pytest.approx([1.0, 2.1, 0.4])
    # Turned to the left, the hip is behind in x; pitched by 90°, the thigh points backwards, which is now -y.
    assert positions[1, knee] == pytest.approx([0.9, 1.6, 0.8])
    assert np.linalg.norm(quats, axis=-1) == pytest.approx(np.ones((2, len(model.bodies))))


def test_joints_go_by_the_name_of_the_wire(model: RobotModel) -> None:
    assert model.knows("left_knee")
    assert model.knows("left_knee_joint")
    assert not model.knows("right_knee")


def test_file_that_is_no_model_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "broken.xml"
    path.write_text("<mujoco>\n<nonsense/>\n</mujoco>")
    with pytest.raises(BadFile, match="not a robot model") as caught:
        RobotModel(path)
    assert "\n" not in str(caught.value)


def test_a_robot_that_stands_fast_is_where_its_base_is_put(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    geom = '<geom type="capsule" size="0.05" fromto="0 0 0 1 0 0"/>'
    fore = f'<body name="fore" pos="1 0 0"><joint name="elbow" axis="0 0 1"/>{geom}</body>'
    upper = f'<body name="upper"><joint name="shoulder" axis="0 0 1"/>{geom}{fore}</body>'
    path.write_text(f"<mujoco><worldbody>{upper}</worldbody></mujoco>")
    arm = RobotModel(path)
    assert not arm.floats
    root = np.array([[0.0, 0, 0, 1, 0, 0, 0], [1.0, 2.0, 0.5, np.sqrt(0.5), 0, 0, np.sqrt(0.5)]])
    positions, quats = arm.poses(root, ["shoulder", "elbow"], np.full((2, 2), [np.pi / 2, 0.0]))
    assert positions[:, arm.bodies.index("fore")] == pytest.approx(np.array([[0.0, 1.0, 0.0], [0.0, 2.0, 0.5]]))
    assert np.abs(quats[1, 0]) == pytest.approx([0.0, 0.0, 0.0, 1.0])


def test_model_of_which_nothing_moves_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "table.xml"
    path.write_text('<mujoco><worldbody><geom type="box" size="1 1 1"/></worldbody></mujoco>')
    with pytest.raises(BadFile, match="without joints"):
        RobotModel(path)


def test_an_arm_is_drawn_whole() -> None:
    model = RobotModel(assets.resolve("builtin:kassow_kr810.xml"))
    assert all(model.knows(joint) for joint in ARM_7)
    assert model.visible == {"base", *(f"link{number}" for number in range(1, 8))}


def test_clustering_keeps_the_shape_and_drops_what_cannot_be_seen() -> None:
    rng = np.random.default_rng(1)
    vertices = rng.uniform(0, 0.1, (3000, 3))
    faces = rng.integers(0, 3000, (6000, 3))
    mesh = clustered(Mesh(vertices, np.tile([0.0, 0, 1], (3000, 1)), faces), 0.02)
    assert len(mesh.vertices) <= 5**3
    assert mesh.faces.max() < len(mesh.vertices)
    assert all(len(set(face)) == 3 for face in mesh.faces.tolist())
    assert mesh.vertices.mean(axis=0) == pytest.approx(vertices.mean(axis=0), abs=0.003)
    assert mesh.normals == pytest.approx(np.tile([0.0, 0, 1], (len(mesh.vertices), 1)))


@pytest.mark.parametrize(
    ("reference", "hand"),
    [
        ("builtin:g1.xml", "right_wrist_yaw_link"),
        pytest.param("twist2:g1/g1_sim2sim_29dof.xml", "right_rubber_hand", marks=pytest.mark.assets),
    ],
)
def test_g1_is_drawn_whole_and_light(reference: str, hand: str) -> None:
    model = RobotModel(assets.resolve(reference))
    assert all(model.knows(joint) for joint in G1_29)
    assert {"pelvis", "torso_link", "left_ankle_roll_link", hand} <= model.visible
    assert sum(len(shape.vertices) for shape in model.shapes) < 50_000
