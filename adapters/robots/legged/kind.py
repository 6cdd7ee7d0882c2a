"""Robots on legs that can be named, simulated in MuJoCo; without a policy of theirs they stand (`direct`)."""

from __future__ import annotations

from functools import partial

import msgspec

from adapters.robots.legged import description
from adapters.robots.legged.table import LeggedRobot
from adapters.robots.legged.unitree import ROBOTS
from station import assets
from station.protocols import Robot
from station.robot_kind import RobotKind


class MujocoOptions(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the simulation.

    Attributes:
        model: MJCF of the robot, a path or ``collection:path``; "" for the built-in one.
        physics_dt_s: Physics step [s].
        latency_steps: Control periods from a target to the motors, as some policies were trained with.
        armature: Rotor inertia of every joint in place of the model's [kg m^2]; 0 for the model's.
        viewer: Whether it opens a window.
    """

    model: str = ""
    physics_dt_s: float = 0.002
    latency_steps: int = 0
    armature: float = 0.0
    viewer: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.latency_steps <= 10:
            raise ValueError(f"latency_steps is {self.latency_steps}; expected 0 to 10")
        if not 0.0 <= self.armature <= 10.0:
            raise ValueError(f"armature is {self.armature:g} kg m^2; expected 0, for the model's, to 10")


def _make(robot: LeggedRobot, options: MujocoOptions, control_dt_s: float) -> Robot:
    from adapters.robots.legged.mujoco_robot import LeggedMujoco

    return LeggedMujoco(
        robot, assets.resolve(options.model or robot.mjcf), physics_dt_s=options.physics_dt_s,
        control_dt_s=control_dt_s, latency_steps=options.latency_steps, armature=options.armature,
        viewer=options.viewer,
    )  # fmt: skip


def kind_of(robot: LeggedRobot, stand: str = "") -> RobotKind:
    """Return what a robot registers.

    Args:
        robot: Its table.
        stand: The file by which `direct` has it stand; "" for the built-in one of that name.
    """
    return RobotKind(
        name=f"{robot.name.replace('_', '-')}-mujoco",
        about=f"{robot.title}, {len(robot.joints)} joints, simulated in MuJoCo",
        is_simulated=True,
        options=MujocoOptions,
        make=partial(_make, robot),
        describe=partial(description.of_server, robot),
        robot_name=robot.name,
        policy="direct",
        checkpoint=stand or f"builtin:{robot.name}.stand.yaml",
    )


GO2, GO1, H1, H1_10, H1_2, H1_2_12, G1_12, G1_23, G1_DEX3 = map(kind_of, ROBOTS.values())
