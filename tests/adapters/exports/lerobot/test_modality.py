from __future__ import annotations

from adapters.exports.lerobot.dataset import group_of


def test_the_joints_of_an_arm_are_one_group_per_quantity() -> None:
    names = [f"state_joints_x.joint_{n}_{what}" for what in ("pos", "vel", "torque") for n in range(1, 8)]
    assert [*dict.fromkeys(map(group_of, names))] == ["joint", "joint_vel", "joint_torque"]
