from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from adapters.robots.g1 import joints
from adapters.robots.g1.joints import G1_25, G1_29


def test_the_table_has_the_joints_of_the_wire_in_their_order() -> None:
    assert tuple(joint.name for joint in joints.JOINTS) == G1_29
    assert tuple(joint.name for joint in joints.select(G1_25)) == G1_25


def test_left_and_right_mirror_each_other_in_the_sagittal_plane() -> None:
    by_name = {joint.name: joint for joint in joints.JOINTS}
    for left in joints.JOINTS:
        if not left.name.startswith("left_"):
            continue
        right = by_name[left.name.replace("left_", "right_")]
        expected = (left.lower, left.upper) if left.axis == "y" else (-left.upper, -left.lower)
        assert (right.lower, right.upper) == expected, left.name
        assert (right.effort_nm, right.velocity_rad_s, right.armature) == (
            left.effort_nm, left.velocity_rad_s, left.armature)  # fmt: skip


@pytest.mark.assets
def test_axes_and_ranges_are_those_of_the_model_that_twist2_is_simulated_with(assets: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(assets / "twist2/g1/g1_sim2sim_29dof.xml"))
    for joint in joints.JOINTS:
        index = model.joint(joint.mjcf_name).id
        np.testing.assert_allclose(model.jnt_range[index], [joint.lower, joint.upper], atol=1e-9)
        np.testing.assert_array_equal(model.jnt_axis[index], np.eye(3)["xyz".index(joint.axis)])
