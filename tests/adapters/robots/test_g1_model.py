"""The built-in G1 and its variant with Dex3 hands against the table of Unitree's numbers, and left against right."""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

from adapters.robots.g1.joints import G1_29, select
from adapters.robots.g1.joints import hand as hand_joints
from adapters.robots.g1.mujoco_g1 import START_Q, MujocoG1
from adapters.robots.legged import mjcf, unitree
from adapters.robots.picture import Camera
from station import rotations
from station.errors import StationError
from station.protocols import Floats
from tests.adapters.robots.g1_models import DEX3, FLOOR, G1, SEEN, TOUCHES, both, compiled, held, posed

SHAPES = {
    mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_PLANE,
}  # fmt: skip
MIRROR = np.diag([1.0, -1.0, 1.0])

Row = dict[str, str]


@cache
def rows(path: Path) -> dict[str, Row]:
    """Rows of the table by link; those of the Dex3 replace the wrists of the bare robot."""
    with Path(__file__).with_name("g1_links.csv").open(newline="", encoding="utf-8") as stream:
        wanted = [row for row in csv.DictReader(stream) if path == DEX3 or row["model"] == "g1"]
    return {row["link"]: row for row in wanted}


def vector(text: str) -> Floats:
    return np.array([float(part) for part in text.split()])


@both
def test_it_is_made_of_simple_shapes_alone_and_is_small(path: Path) -> None:
    model = compiled(path)
    assert (model.nmesh, model.nhfield, model.nskin) == (0, 0, 0)
    assert {mujoco.mjtGeom(kind) for kind in model.geom_type} <= SHAPES
    assert path.stat().st_size < 60_000


@both
def test_the_links_are_those_of_the_table(path: Path) -> None:
    model = compiled(path)
    assert {model.body(i).name for i in range(1, model.nbody)} == set(rows(path))
    for name, row in rows(path).items():
        body = model.body(name)
        assert model.body(body.parentid[0]).name == row["parent"]
        assert body.mass[0] == pytest.approx(float(row["mass_kg"]), rel=1e-6), name
        np.testing.assert_allclose(body.ipos, vector(row["com"]), atol=1e-9, err_msg=name)
        expected = tensor(vector(row["inertia"]), vector(row["inertia_quat_wxyz"]))
        np.testing.assert_allclose(tensor(body.inertia, body.iquat), expected, rtol=1e-4, atol=2e-10, err_msg=name)


def tensor(principal: Floats, quat_wxyz: Floats) -> Floats:
    axes = rotations.rotate(rotations.normalized(quat_wxyz), np.eye(3)).T
    return np.asarray(axes @ np.diag(principal) @ axes.T)


@both
def test_the_links_are_where_the_table_puts_them_at_joint_position_zero(path: Path) -> None:
    model = compiled(path)
    data = posed(model, np.zeros(29))
    place: dict[str, tuple[Floats, Floats]] = {"world": (np.zeros(3), np.array([1.0, 0, 0, 0]))}
    for name, row in rows(path).items():  # parents come before their children
        position, quat = place[row["parent"]]
        place[name] = (
            position + rotations.rotate(quat, vector(row["pos"])),
            rotations.multiply(quat, rotations.normalized(vector(row["quat_wxyz"]))),
        )
        np.testing.assert_allclose(data.body(name).xpos, place[name][0], atol=1e-9, err_msg=name)
        np.testing.assert_allclose(abs(data.body(name).xquat @ place[name][1]), 1.0, atol=1e-9, err_msg=name)


@both
def test_the_joints_are_those_of_the_table(path: Path) -> None:
    model = compiled(path)
    for row in (row for row in rows(path).values() if row["joint"]):
        joint = model.joint(row["joint"])
        effort = float(row["effort_nm"])
        assert model.body(model.jnt_bodyid[joint.id]).name == row["link"]
        np.testing.assert_array_equal(joint.axis, np.eye(3)["xyz".index(row["axis"])])
        np.testing.assert_array_equal(joint.pos, 0)
        np.testing.assert_allclose(joint.range, [float(row["lower"]), float(row["upper"])], atol=1e-9)
        np.testing.assert_allclose(model.jnt_actfrcrange[joint.id], [-effort, effort])
        assert model.jnt_actfrclimited[joint.id]
        if row["armature"]:
            assert model.dof_armature[joint.dofadr[0]] == pytest.approx(float(row["armature"]), rel=1e-9)
            assert model.dof_frictionloss[joint.dofadr[0]] == 0.1
            assert model.dof_damping[joint.dofadr[0]] == 0
    assert not model.dof_frictionloss[:6].any()


def test_masses_add_up_to_those_of_the_robot() -> None:
    assert compiled(G1).body_subtreemass[0] == pytest.approx(33.34, rel=0.005)
    assert compiled(DEX3).body_subtreemass[0] == pytest.approx(33.341 + 2 * 0.5263, rel=1e-3)


@both
def test_there_is_a_servo_for_every_motor_in_the_order_of_the_table(path: Path) -> None:
    model = compiled(path)
    expected = [joint.mjcf_name for joint in (unitree.G1_DEX3 if path == DEX3 else unitree.G1).joints]
    assert [model.joint(model.actuator_trnid[u, 0]).name for u in range(model.nu)] == expected
    for u in range(model.nu):
        np.testing.assert_array_equal(model.actuator_forcerange[u], model.jnt_actfrcrange[model.actuator_trnid[u, 0]])
        assert model.actuator_forcelimited[u]


@both
def test_made_ready_for_the_station_a_servo_gives_what_motor_and_stock_simulation_allow(path: Path) -> None:
    spec = mujoco.MjSpec.from_file(str(path))
    mjcf.prepare(spec, unitree.G1)
    model = spec.compile()
    for joint, clip in zip(select(G1_29), unitree.G1.torques_nm, strict=True):
        servo = model.actuator(joint.mjcf_name)
        limit = min(joint.effort_nm, clip)
        np.testing.assert_array_equal(servo.forcerange, [-limit, limit])
        assert not servo.gainprm.any()
        assert not servo.biasprm.any()
        assert not servo.ctrllimited[0]
    assert sum(geom.type == mujoco.mjtGeom.mjGEOM_PLANE for geom in spec.worldbody.geoms) == 1


@both
def test_what_is_seen_touches_nothing_and_what_touches_is_not_seen(path: Path) -> None:
    model = compiled(path)
    asks = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    assert set(model.geom_group) == {FLOOR, SEEN, TOUCHES}
    np.testing.assert_array_equal(asks, model.geom_group != SEEN)
    touches = model.geom_group == TOUCHES
    assert (model.geom_conaffinity[touches] & 1).all(), "the ground"
    soles = [g for g in np.flatnonzero(touches) if model.body(model.geom_bodyid[g]).name.endswith("ankle_roll_link")]
    assert len(soles) == 8
    np.testing.assert_array_equal(model.geom_size[soles, 0], 0.005)


@both
def test_left_and_right_mirror_each_other(path: Path) -> None:
    model = compiled(path)
    for kind in (describe_geoms, describe_places):
        assert kind(model, mirrored=True) == kind(model, mirrored=False)


def describe_geoms(model: mujoco.MjModel, *, mirrored: bool) -> set[object]:
    """Every geom of the robot as something that can be compared, or its mirror image."""
    found = set()
    for g in np.flatnonzero(model.geom_bodyid):
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, model.geom_quat[g])
        axes = axes.reshape(3, 3).T  # a row per axis of the geom; each shape is its own mirror image along them
        if mujoco.mjtGeom(model.geom_type[g]) in (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER):
            axes = axes[2:]
        position, bits = model.geom_pos[g], (model.geom_contype[g], model.geom_conaffinity[g])
        if mirrored:
            axes, position = axes @ MIRROR, MIRROR @ position
            bits = tuple((bit & 1) | (bit & 2) << 1 | (bit & 4) >> 1 for bit in bits)  # the two arms
        signs = np.sign(axes[np.arange(len(axes)), np.abs(axes).argmax(axis=1)])
        look = (int(model.geom_type[g]), int(model.geom_group[g]), int(model.geom_matid[g]), *map(int, bits))
        numbers = (*position, *model.geom_size[g], *(axes * signs[:, None]).ravel())
        found.add((swapped(model.body(model.geom_bodyid[g]).name, mirrored), look, rounded(numbers)))
    return found


def describe_places(model: mujoco.MjModel, *, mirrored: bool) -> set[object]:
    """Every site and camera that has a side."""
    sites = [(model.site(i).name, model.site(i).bodyid[0], model.site_pos[i]) for i in range(model.nsite)]
    cameras = [(model.camera(i).name, model.camera(i).bodyid[0], model.cam_pos[i]) for i in range(model.ncam)]
    return {
        (swapped(name, mirrored), swapped(model.body(body).name, mirrored), rounded(MIRROR @ at if mirrored else at))
        for name, body, at in sites + cameras
        if "left" in name or "right" in name
    }


def swapped(name: str, mirrored: bool) -> str:
    other = {"left": "right", "right": "left"}
    return "_".join(other.get(part, part) if mirrored else part for part in name.split("_"))


def rounded(numbers: object) -> tuple[float, ...]:
    return tuple(float(number) + 0.0 for number in np.round(np.asarray(numbers), 6))


@both
def test_imus_head_palms_and_wrists_have_their_places_and_cameras_look_ahead(path: Path) -> None:
    model = compiled(path)
    data = posed(model, START_Q)
    np.testing.assert_allclose(model.site("imu_in_pelvis").pos, (0.04525, 0, -0.08339))
    np.testing.assert_allclose(model.site("imu_in_torso").pos, (-0.03959, -0.00224, 0.14792))
    np.testing.assert_allclose(data.site("head_camera").xpos, data.cam("head").xpos)
    assert 1.15 < data.site("head_camera").xpos[2] < 1.32
    for side in ("left", "right"):
        np.testing.assert_allclose(model.site(f"{side}_palm").pos, (0.08, 0, 0))
        assert model.body(model.site(f"{side}_palm").bodyid[0]).name == f"{side}_wrist_yaw_link"
        np.testing.assert_allclose(data.site(f"{side}_wrist").xpos, data.body(f"{side}_wrist_yaw_link").xpos)
        forearm = data.body(f"{side}_wrist_yaw_link").xmat.reshape(3, 3)[:, 0]
        assert looks(data, f"{side}_wrist") @ forearm > 0.8
    forward, _, up = looks(data, "head")
    assert forward > 0.8
    assert -0.6 < up < -0.2
    assert model.camera("track").mode[0] == mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM


def looks(data: mujoco.MjData, camera: str) -> Floats:
    return np.asarray(-data.cam(camera).xmat.reshape(3, 3)[:, 2])


@pytest.mark.parametrize("name", ["track", "head", "left_wrist", "right_wrist"])
def test_every_camera_gives_a_picture(name: str) -> None:
    model = mjcf.load(unitree.G1, G1, is_drawn=True)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    try:
        camera = Camera(model, 160, 120)
    except StationError as error:
        pytest.skip(str(error))
    picture = camera.capture(data, name)
    camera.close()
    assert picture.shape == (120, 160, 3)
    assert picture.std() > 5


def test_the_hands_are_seven_joints_each_and_servos_hold_them_where_they_are_told() -> None:
    hinges = {path: (compiled(path).jnt_type == mujoco.mjtJoint.mjJNT_HINGE).sum() for path in (G1, DEX3)}
    assert hinges == {G1: 29, DEX3: 43}
    robot = MujocoG1(DEX3, physics_dt_s=0.002)
    hand = [robot._model.joint(f"{name}_joint") for name in hand_joints("left")]
    servos = [robot._model.actuator(f"{name}_joint").id for name in hand_joints("left")]
    told = np.array([(low if abs(low) > abs(high) else high) / 2 for low, high in (joint.range for joint in hand)])
    robot._data.ctrl[servos] = told
    for _ in range(40):
        robot.write(held(START_Q))
    assert robot.fallen() is None
    held_at = robot._data.qpos[[joint.qposadr[0] for joint in hand]]
    np.testing.assert_allclose(held_at, told, atol=0.15)
