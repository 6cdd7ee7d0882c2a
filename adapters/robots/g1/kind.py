"""The Unitree G1 as a robot that can be named: simulated in MuJoCo."""

from __future__ import annotations

from adapters.robots.g1 import description, wire
from adapters.robots.legged import kind as legged
from adapters.robots.legged.unitree import G1
from station import assets
from station.protocols import Robot
from station.robot_kind import RobotKind


class MujocoOptions(legged.MujocoOptions, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the simulation; the rest is as of any robot on legs.

    Attributes:
        model: MJCF of the robot, a path or ``collection:path``.
        physics_dt_s: Physics step [s].
    """

    model: str = G1.mjcf
    physics_dt_s: float = 0.001


def _make(options: MujocoOptions, control_dt_s: float) -> Robot:
    from adapters.robots.g1.mujoco_g1 import MujocoG1

    return MujocoG1(
        assets.resolve(options.model), physics_dt_s=options.physics_dt_s, control_dt_s=control_dt_s,
        latency_steps=options.latency_steps, armature=options.armature, viewer=options.viewer,
    )  # fmt: skip


MUJOCO = RobotKind(
    name="g1-mujoco",
    about="Unitree G1 with 29 joints, simulated in MuJoCo",
    is_simulated=True,
    options=MujocoOptions,
    make=_make,
    describe=description.of_server,
    values=wire.stock_values,
    policy="tracker",
    is_default=True,
    robot_name="g1_29",
)
