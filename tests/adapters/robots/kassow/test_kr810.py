"""The KR810: our kinematics against MuJoCo's of our model, the model against the file of limits, and its posture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.robots import arm_limits
from adapters.robots.kassow import kinematics
from adapters.robots.kassow.description import describe
from adapters.robots.kassow.kinematics import KR810, REACHING_DOWN
from adapters.robots.kassow.names import ARM_7, suffix
from station import assets, rotations
from station.errors import ConfigError
from station.protocols import Floats
from tests.examples import examples

LIMITS = arm_limits.load("kassow", "kr810")
anywhere = st.lists(st.floats(-6.28, 6.28), min_size=7, max_size=7).map(np.array)


@pytest.fixture(scope="module")
def model() -> Any:
    return mujoco.MjModel.from_xml_path(str(assets.resolve("builtin:kassow_kr810.xml")))


@settings(max_examples=examples(60), deadline=None)
@given(q=anywhere)
def test_flange_and_jacobian_are_where_mujoco_has_them(model: Any, q: Floats) -> None:
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    posture = KR810.posture(q)
    flange = data.site("flange")
    assert posture.position == pytest.approx(flange.xpos, abs=1e-9)
    assert posture.rotation == pytest.approx(flange.xmat.reshape(3, 3), abs=1e-9)
    along, about = np.empty((3, 7)), np.empty((3, 7))
    mujoco.mj_jacSite(model, data, along, about, flange.id)
    assert posture.jacobian() == pytest.approx(np.vstack([along, about]), abs=1e-9)


@settings(max_examples=examples(100), deadline=None)
@given(q=anywhere)
def test_the_quaternion_of_a_pose_is_its_rotation_also_where_that_is_half_a_turn(q: Floats) -> None:
    posture = KR810.posture(q)
    columns = [rotations.rotate(posture.pose.quat_wxyz, axis) for axis in np.eye(3)]
    assert np.stack(columns, axis=-1) == pytest.approx(posture.rotation, abs=1e-9)


def test_the_model_has_the_ranges_of_the_file_of_limits(model: Any) -> None:
    assert tuple(model.joint(index).name for index in range(model.njnt)) == ARM_7
    assert model.jnt_range == pytest.approx(np.stack([LIMITS.q_min, LIMITS.q_max], axis=1), abs=1e-8)


def test_an_arm_with_a_name_is_drawn_as_any_of_its_model() -> None:
    named, only = describe(suffix("kr810", "left")), describe(suffix("kr810"))
    assert named is not None
    assert only is not None
    assert (named.name, only.name) == ("kassow_kr810_left", "kassow_kr810")
    assert (named.drawn_as, named.model) == (only.drawn_as, only.model) == ("builtin:kassow_kr810.xml", "kassow_kr810")


def test_upright_the_flange_is_as_high_as_all_links_together_and_beside_the_base() -> None:
    pose = KR810.posture(np.zeros(7)).pose
    assert pose.position == pytest.approx([0.0, -0.0857 + 0.08405 + 0.111, 1.2081])
    assert pose.quat_wxyz == pytest.approx([1.0, 0.0, 0.0, 0.0])


def test_reaching_down_the_tool_points_down_far_from_limits_and_singularities() -> None:
    q = np.array(REACHING_DOWN)
    posture = KR810.posture(q)
    assert posture.rotation[:, 2] == pytest.approx([0.0, 0.0, -1.0], abs=1e-6)
    assert np.linalg.svd(posture.jacobian(), compute_uv=False)[-1] > 0.15
    assert (q > LIMITS.q_min + 1.0).all()
    assert (q < LIMITS.q_max - 1.0).all()


def test_a_longer_tool_reaches_further_along_its_own_axis() -> None:
    q = np.array(REACHING_DOWN)
    way = KR810.with_tool((0.0, 0.0, 0.2)).posture(q).position - KR810.posture(q).position
    assert way == pytest.approx([0.0, 0.0, -0.2], abs=1e-6)


def test_a_model_that_nobody_has_measured_is_refused_in_a_line() -> None:
    with pytest.raises(ConfigError) as caught:
        kinematics.chain("kr1805")
    assert str(caught.value).startswith("model 'kr1805': its kinematics are not known, only those of kr810; drive its")
    assert "\n" not in str(caught.value)


def test_limits_say_where_they_come_from() -> None:
    assert "kr810_description.urdf.xacro" in LIMITS.source
    assert LIMITS.file == Path(kinematics.__file__).with_name("kr810.yaml")
