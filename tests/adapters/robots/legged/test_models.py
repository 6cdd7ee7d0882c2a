"""The built-in models of robots on legs against their tables, upstream's models, and one side against the other."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from adapters.robots.legged import models
from adapters.robots.legged.table import LeggedRobot
from adapters.robots.legged.unitree import ROBOTS
from station import assets, rotations
from station.protocols import Floats
from station.view.model import RobotModel
from tests.adapters.robots.g1_models import FLOOR, SEEN, TOUCHES
from tests.adapters.robots.test_g1_model import SHAPES, describe_geoms, tensor

each = pytest.mark.parametrize("robot", ROBOTS.values(), ids=lambda robot: robot.name)

ORIGINALS = {
    "go2": "go2", "go1": "go1_playground", "h1": "h1_10dof", "h1_10": "h1_10dof", "h1_2": "h1_2_12dof",
    "h1_2_12": "h1_2_12dof", "g1_12": "g1_12dof",
}  # fmt: skip
"""Upstream's models without meshes, by robot."""
LUMPED = {name: {"pelvis", "left_ankle_link", "right_ankle_link"} for name in ("h1", "h1_10")}
"""Links that weigh something else there: they hold what has no joint there; another revision's feet."""


@cache
def compiled(path: Path) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(path))


def own(robot: LeggedRobot) -> mujoco.MjModel:
    return compiled(assets.resolve(robot.mjcf))


def test_the_files_are_what_the_tables_give() -> None:
    for path, text in models.files():
        assert path.read_text(encoding="utf-8") == text, f"{path.name}: run models.py"
        assert len(text) < 60_000


@each
def test_it_is_made_of_simple_shapes_of_which_those_that_touch_are_not_seen(robot: LeggedRobot) -> None:
    model = own(robot)
    assert (model.nmesh, model.nhfield, model.nskin) == (0, 0, 0)
    assert {mujoco.mjtGeom(kind) for kind in model.geom_type} <= SHAPES
    assert set(model.geom_group) == {FLOOR, SEEN, TOUCHES}
    asks = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    np.testing.assert_array_equal(asks, model.geom_group != SEEN)


@each
def test_its_joints_and_servos_are_those_of_the_table_in_its_order(robot: LeggedRobot) -> None:
    model = own(robot)
    assert [model.joint(index).name for index in range(1, model.njnt)] == [joint.mjcf_name for joint in robot.joints]
    assert [model.joint(model.actuator_trnid[u, 0]).name for u in range(model.nu)] == [
        joint.mjcf_name for joint in robot.joints
    ]
    for index, joint in enumerate(robot.joints, start=1):
        np.testing.assert_array_equal(model.jnt_axis[index], np.eye(3)["xyz".index(joint.axis)])
        np.testing.assert_allclose(model.jnt_range[index], [joint.lower, joint.upper])
        np.testing.assert_allclose(model.jnt_actfrcrange[index], [-joint.effort_nm, joint.effort_nm])
        assert model.dof_armature[model.jnt_dofadr[index]] == pytest.approx(joint.armature)
        assert model.dof_damping[model.jnt_dofadr[index]] == 0, "a policy's gains are all the damping there is"
    np.testing.assert_allclose(model.key("stand").qpos[7:], robot.start_q)


@each
def test_its_masses_add_up(robot: LeggedRobot) -> None:
    whole = {"go2": 15.017, "go1": 12.743, "h1": 51.437, "h1_10": 51.437, "h1_2": 67.267,
             "h1_2_12": 67.267, "g1_12": 32.107, "g1_23": 32.107, "g1_dex3": 34.394}  # fmt: skip
    assert own(robot).body_subtreemass[0] == pytest.approx(whole[robot.name], abs=1e-3)


@each
def test_left_and_right_mirror_each_other(robot: LeggedRobot) -> None:
    model = own(robot)
    assert sides(describe_geoms(model, mirrored=True)) == describe_geoms(model, mirrored=False)


def sides(found: set[Any]) -> set[object]:
    """What `describe_geoms` mirrors, with the legs of a quadruped swapped, too."""
    other = {"FL": "FR", "FR": "FL", "RL": "RR", "RR": "RL"}

    def swapped(name: str) -> str:
        return other[name[:2]] + name[2:] if name[:2] in other and name[2:3] == "_" else name

    return {(swapped(geom[0]), *geom[1:]) for geom in found}


@pytest.mark.assets
@pytest.mark.parametrize("name", ORIGINALS)
def test_links_weigh_and_stand_what_and_where_upstreams_do(name: str, assets: Path) -> None:
    robot = ROBOTS[name]
    ours, theirs = own(robot), compiled(assets / f"zoo/models/{ORIGINALS[name]}.xml")
    data = [mujoco.MjData(model) for model in (ours, theirs)]
    for model, each_data in zip((ours, theirs), data, strict=True):
        each_data.qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
        mujoco.mj_kinematics(model, each_data)
    named = [{model.body(i).name for i in range(1, model.nbody)} for model in (ours, theirs)]
    links = named[0] & named[1]
    assert len(links) >= theirs.njnt
    for link in sorted(links):
        body, other = ours.body(link), theirs.body(link)
        np.testing.assert_allclose(data[0].body(link).xpos, data[1].body(link).xpos, atol=1e-9, err_msg=link)
        assert abs(data[0].body(link).xquat @ data[1].body(link).xquat) == pytest.approx(1.0, abs=1e-9), link
        if link in LUMPED.get(name, ()):
            continue
        assert body.mass[0] == pytest.approx(other.mass[0], rel=1e-6), link
        # The two wrists of an H1-2 are not quite each other's mirror image.
        np.testing.assert_allclose(body.ipos, other.ipos, atol=2e-5, err_msg=link)
        np.testing.assert_allclose(
            tensor(body.inertia, body.iquat), tensor(other.inertia, other.iquat), rtol=2e-3, atol=1e-6, err_msg=link
        )
    for joint in robot.joints:
        if joint.mjcf_name in {theirs.joint(index).name for index in range(theirs.njnt)}:
            np.testing.assert_allclose(theirs.joint(joint.mjcf_name).range, [joint.lower, joint.upper], atol=1e-9)


@pytest.mark.assets
@pytest.mark.parametrize(("name", "original"), [("h1", "h1_10dof"), ("h1_10", "h1_10dof"), ("g1_23", "g1_12dof")])
def test_trunk_and_arms_together_weigh_what_upstream_puts_into_one_pelvis(
    name: str, original: str, assets: Path
) -> None:
    """Two models of 10 and 12 joints hold the upper body in their pelvis: its mass, centre and inertia at zero."""
    model, pelvis = own(ROBOTS[name]), compiled(assets / f"zoo/models/{original}.xml").body("pelvis")
    data = mujoco.MjData(model)
    data.qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
    mujoco.mj_kinematics(model, data)
    legs = ("hip", "knee", "ankle")
    upper = [b for b in range(1, model.nbody) if not any(part in model.body(b).name for part in legs)]
    masses = model.body_mass[upper]
    centre = masses @ data.xipos[upper] / masses.sum()
    assert masses.sum() == pytest.approx(pelvis.mass[0], rel=1e-4)
    np.testing.assert_allclose(centre, pelvis.ipos, atol=2e-4)
    total: Floats = np.zeros((3, 3))
    for body, mass in zip(upper, masses, strict=True):
        away = data.xipos[body] - centre
        axes = data.ximat[body].reshape(3, 3)
        total += axes @ np.diag(model.body_inertia[body]) @ axes.T + mass * (
            away @ away * np.eye(3) - np.outer(away, away)
        )
    np.testing.assert_allclose(total, tensor(pelvis.inertia, pelvis.iquat), rtol=2e-3, atol=1e-3)


@each
def test_it_looks_ahead_and_is_drawn_whole_with_every_joint(robot: LeggedRobot) -> None:
    model = own(robot)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    ahead = -data.cam("head").xmat.reshape(3, 3)[:, 2]
    assert ahead[0] > 0.8
    assert abs(ahead[1]) < 0.01
    assert model.camera("track").mode[0] == mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM
    drawn = RobotModel(assets.resolve(robot.mjcf))
    assert drawn.floats
    assert all(drawn.knows(joint) for joint in robot.joint_names)
    moved = {link.removesuffix("_link") for link in drawn.visible}
    inside = {"g1_dex3": 2}.get(robot.name, 0)  # two links of its waist are within the trunk
    assert len(moved) >= len(robot.joints) - inside, "a limb without a shape"


def test_the_mirror_image_of_a_link_turns_the_other_way() -> None:
    link = models.Link("left_a", "left_b", "left_c", (1, 2, 3), 1.0, (4, 5, 6), (0.7, 0.5, -0.1, 0.5), (1, 2, 3),
                       turned=(0.8, 0.6, 0, 0))  # fmt: skip
    right = models._other_side(link, ("left_", "right_"))
    assert (right.name, right.parent, right.joint) == ("right_a", "right_b", "right_c")
    assert (right.position, right.com) == ((1, -2, 3), (4, -5, 6))
    flip = np.diag([1.0, -1.0, 1.0])
    expected = flip @ tensor(np.array(link.inertia), np.array(link.axes)) @ flip
    np.testing.assert_allclose(tensor(np.array(right.inertia), np.array(right.axes)), expected, atol=1e-12)
    point = np.array([0.3, -0.2, 0.7])
    there = rotations.rotate(np.array(link.turned, dtype=float), point)
    np.testing.assert_allclose(rotations.rotate(np.array(right.turned, dtype=float), flip @ point), flip @ there)
