"""The tables of robots on legs: that they fit together, and what of them only their makers can say."""

from __future__ import annotations

import pytest

from adapters.robots.g1.joints import G1_29, hand
from adapters.robots.legged import unitree
from adapters.robots.legged.table import LeggedRobot
from adapters.robots.legged.unitree import G1, G1_12, G1_23, G1_DEX3, GO1, GO2, H1, H1_2, H1_2_12, H1_10, ROBOTS

each = pytest.mark.parametrize("robot", [*ROBOTS.values(), G1], ids=lambda robot: robot.name)


@each
def test_every_joint_has_one_name_one_motor_and_one_limb(robot: LeggedRobot) -> None:
    names = robot.joint_names
    assert len(set(names)) == len(names)
    assert all(name.isidentifier() for name in names)
    assert len(set(robot.motors)) == len(robot.motors) == len(names)
    assert sorted(name for limb in robot.groups.values() for name in limb) == sorted(names)


@each
def test_it_starts_within_its_limits_and_every_number_can_be_one(robot: LeggedRobot) -> None:
    columns = (robot.start_q, robot.stand_kp, robot.stand_kd, robot.torques_nm)
    assert {len(column) for column in columns} == {len(robot.joints)}
    for joint, q, kp, kd, torque in zip(robot.joints, *columns, strict=True):
        assert joint.lower < q < joint.upper, joint.name
        assert min(kp, kd, torque, joint.effort_nm, joint.velocity_rad_s, joint.armature) > 0, joint.name
    assert 0 <= robot.least_height_m < 0.6 * robot.start_height_m


@each
def test_one_side_mirrors_the_other(robot: LeggedRobot) -> None:
    by_name = {joint.name: (joint, q) for joint, q in zip(robot.joints, robot.start_q, strict=True)}
    others = {"left_": "right_", "FL_": "FR_", "RL_": "RR_"}
    for start, other in others.items():
        for name in (name for name in by_name if name.startswith(start)):
            (left, q), (right, mirrored_q) = by_name[name], by_name[name.replace(start, other)]
            sign = 1 if left.axis == "y" else -1
            expected = (left.lower, left.upper) if sign == 1 else (-left.upper, -left.lower)
            assert (right.lower, right.upper, mirrored_q) == (*expected, sign * q), name
            assert (right.axis, right.effort_nm, right.velocity_rad_s, right.armature) == (
                left.axis, left.effort_nm, left.velocity_rad_s, left.armature)  # fmt: skip


def test_motors_are_where_the_makers_messages_have_them() -> None:
    """Joints in the order of the messages; None where an H1 has no motor."""

    def sent(robot: LeggedRobot) -> dict[int, str]:
        return dict(sorted(zip(robot.motors, robot.joint_names, strict=True)))

    legs = [f"{corner}_{joint}" for corner in ("FR", "FL", "RR", "RL") for joint in ("hip", "thigh", "calf")]
    assert list(sent(GO2).items()) == list(enumerate(legs))
    assert list(sent(GO1).items()) == list(enumerate(legs))
    h1 = sent(H1)
    assert [h1.get(motor) for motor in range(20)] == [
        "right_hip_roll", "right_hip_pitch", "right_knee", "left_hip_roll", "left_hip_pitch", "left_knee", "torso",
        "left_hip_yaw", "right_hip_yaw", None, "left_ankle", "right_ankle",
        "right_shoulder_pitch", "right_shoulder_roll", "right_shoulder_yaw", "right_elbow",
        "left_shoulder_pitch", "left_shoulder_roll", "left_shoulder_yaw", "left_elbow",
    ]  # fmt: skip
    assert H1_2.motors == tuple(range(27))
    assert H1_2_12.motors == tuple(range(12))
    assert all(h1[motor] == name for motor, name in sent(H1_10).items())
    hands = (*G1_29, *hand("left"), *hand("right"))
    assert [sent(G1_DEX3)[motor] for motor in range(43)] == [*hands]
    assert all(G1_29[motor] == name for robot in (G1, G1_12, G1_23) for motor, name in sent(robot).items())


def test_the_number_of_joints_is_that_of_the_robot() -> None:
    assert {name: len(robot.joints) for name, robot in ROBOTS.items()} == {
        "go2": 12, "go1": 12, "h1": 19, "h1_10": 10, "h1_2": 27, "h1_2_12": 12, "g1_12": 12, "g1_23": 23, "g1_dex3": 43,
    }  # fmt: skip
    missing = set(G1_29) - set(G1_23.joint_names)
    assert missing == {"waist_roll", "waist_pitch", "left_wrist_pitch", "left_wrist_yaw", "right_wrist_pitch",
                       "right_wrist_yaw"}  # fmt: skip


def test_the_rear_thighs_of_a_go2_turn_otherwise_than_its_front_ones() -> None:
    by_name = {joint.name: joint for joint in unitree.GO2.joints}
    assert (by_name["FL_thigh"].lower, by_name["FL_thigh"].upper) == (-1.5708, 3.4907)
    assert (by_name["RL_thigh"].lower, by_name["RL_thigh"].upper) == (-0.5236, 4.5379)
