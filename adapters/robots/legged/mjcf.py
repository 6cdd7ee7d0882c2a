"""A model of a robot on legs made ready for the station: every joint a position servo, explicit integration, a floor.

The engine's servo computes ``kp ctrl - kp q - kd dq`` from the state at the top of each physics step and clips it, as
the loops of TWIST and TWIST2 do in Python. With the Euler integrator that torque is explicit, so both give the same
motion (`tests/adapters/robots/test_mujoco_g1.py` shows it), and the engine can take many steps in one call.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container
from functools import partial
from pathlib import Path

import mujoco

from adapters.robots import model_cache
from adapters.robots.legged.table import Joint, LeggedRobot


def in_model(joint: Joint, named: Container[str]) -> str:
    """Return what a model whose joints are named calls a joint: as the maker does, or without the ``_joint``."""
    return joint.mjcf_name if joint.mjcf_name in named else joint.name


def load(robot: LeggedRobot, path: Path, *, is_drawn: bool, armature: float = 0.0) -> mujoco.MjModel:
    """Return a robot's model, compiled; gains are zero, and set at run time.

    Args:
        robot: The robot.
        path: The MJCF file.
        is_drawn: Whether it is for pictures. Without what is only seen (visual meshes above all) the motion is the same
            to the last bit, and a meshed G1 takes 43 MB less.
        armature: Rotor inertia of every joint in place of the model's [kg m^2]; 0 for the model's.

    Raises:
        BadFile: no such file, or no model of this robot.
    """
    change: Callable[[mujoco.MjSpec], None] = partial(
        prepare if is_drawn else _prepare_unseen, robot=robot, armature=armature
    )
    return model_cache.load(path, change, salt=Path(__file__).read_bytes() + f"{is_drawn} {armature} {robot}".encode())


def prepare(spec: mujoco.MjSpec, robot: LeggedRobot, armature: float = 0.0) -> None:
    """Change a parsed model in place; gains start at zero and are set at run time.

    Raises:
        ValueError: a joint or the free joint of the root is missing.
    """
    joints = _joints(spec, robot)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    actuators = {actuator.target: actuator for actuator in spec.actuators}
    for row, joint, limit_nm in zip(robot.joints, joints, robot.torques_nm, strict=True):
        actuator = actuators.get(joint.name) or spec.add_actuator(name=joint.name, target=joint.name)
        _make_servo(actuator, limit_nm)
        if armature or (robot.fills_armature and not joint.armature):
            joint.armature = armature or row.armature
    if not _has_ground(spec):
        spec.worldbody.add_geom(name="station_floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05])


def _prepare_unseen(spec: mujoco.MjSpec, robot: LeggedRobot, armature: float) -> None:
    prepare(spec, robot, armature)
    spec.compiler.discardvisual = True


def _joints(spec: mujoco.MjSpec, robot: LeggedRobot) -> list[mujoco.MjsJoint]:
    """Return the joints of a robot in its model, in the order of its table."""
    named = {joint.name: joint for joint in spec.joints}
    names = [in_model(joint, named) for joint in robot.joints]
    missing = [joint.mjcf_name for joint, name in zip(robot.joints, names, strict=True) if name not in named]
    if missing:
        more = " …" if len(missing) > 3 else ""
        raise ValueError(
            f"expected the {len(names)} joints of a {robot.title}, {len(missing)} are missing: "
            f"{', '.join(missing[:3])}{more}"
        )
    free = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    if [joint.parent.name for joint in free] != [robot.root]:
        raise ValueError(f"expected one free joint, that of the {robot.root}; came {len(free)}")
    return [named[name] for name in names]


def _make_servo(actuator: mujoco.MjsActuator, limit_nm: float) -> None:
    actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
    actuator.gear = [1, 0, 0, 0, 0, 0]
    actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
    actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    actuator.gainprm[:] = 0
    actuator.biasprm[:] = 0
    actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_FALSE
    limit_nm = min(limit_nm, _own_limit(actuator))
    actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    actuator.forcerange = [-limit_nm, limit_nm]
    actuator.inheritrange = 0


def _own_limit(actuator: mujoco.MjsActuator) -> float:
    """The limit that the model gives [N m]; a range alone says that there is one, unless it is switched off."""
    lower, upper = actuator.forcerange
    is_limited = actuator.forcelimited != mujoco.mjtLimited.mjLIMITED_FALSE and lower < upper
    return float(upper) if is_limited else math.inf


def _has_ground(spec: mujoco.MjSpec) -> bool:
    grounds = (mujoco.mjtGeom.mjGEOM_PLANE, mujoco.mjtGeom.mjGEOM_HFIELD)
    return any(geom.type in grounds and (geom.contype or geom.conaffinity) for geom in spec.worldbody.geoms)
