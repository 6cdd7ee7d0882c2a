"""A G1 model file made ready for the station: every joint a position servo, explicit integration, a floor.

The engine's servo computes ``kp ctrl - kp q - kd dq`` from the state at the top of each physics step and clips it, as
the loops of TWIST and TWIST2 do in Python. With the Euler integrator that torque is explicit, so both give the same
motion (`tests/adapters/robots/test_mujoco_g1.py` shows it), and the engine can take many steps in one call.
"""

from __future__ import annotations

import math
from pathlib import Path

import mujoco

from adapters.robots import model_cache
from adapters.robots.g1.joints import G1_29, select

# Clip of the stock TWIST2 simulation [N m], by the end of the joint's name; the model's own `actuatorfrcrange` clips
# again after it. Source: facts of amazon-far/TWIST2, `server_low_level_g1_sim.py`.
_TORQUE_CLIP_NM = {
    "hip_pitch": 100.0,
    "hip_roll": 100.0,
    "hip_yaw": 100.0,
    "knee": 150.0,
    "ankle_pitch": 40.0,
    "ankle_roll": 40.0,
    "waist_yaw": 150.0,
    "waist_roll": 150.0,
    "waist_pitch": 150.0,
    "shoulder_pitch": 40.0,
    "shoulder_roll": 40.0,
    "shoulder_yaw": 40.0,
    "elbow": 40.0,
    "wrist_roll": 4.0,
    "wrist_pitch": 4.0,
    "wrist_yaw": 4.0,
}

TORQUE_CLIP_NM = tuple(_TORQUE_CLIP_NM[name.removeprefix("left_").removeprefix("right_")] for name in G1_29)
"""Greatest torque of each servo [N m], in the order of `G1_29`."""

ROOT_BODY, FOOT_SUFFIX = "pelvis", "ankle_roll_link"


def load(path: Path, *, is_drawn: bool) -> mujoco.MjModel:
    """Return a G1's model, compiled; gains are zero, and set at run time.

    Args:
        path: The MJCF file.
        is_drawn: Whether it is for pictures. Without what is only seen (visual meshes above all) the motion is the same
            to the last bit, and a meshed G1 takes 43 MB less.

    Raises:
        BadFile: no such file, or no model of a G1.
    """
    change = prepare if is_drawn else _prepare_unseen
    return model_cache.load(path, change, salt=Path(__file__).read_bytes() + change.__name__.encode())


def prepare(spec: mujoco.MjSpec) -> None:
    """Change a parsed G1 model in place; gains start at zero and are set at run time.

    Raises:
        ValueError: a joint or the free joint of the pelvis is missing.
    """
    _check(spec)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    actuators = {actuator.target: actuator for actuator in spec.actuators}
    for joint, limit in zip(select(G1_29), TORQUE_CLIP_NM, strict=True):
        actuator = actuators.get(joint.mjcf_name) or spec.add_actuator(name=joint.mjcf_name, target=joint.mjcf_name)
        _make_servo(actuator, limit)
    if not _has_ground(spec):
        spec.worldbody.add_geom(name="station_floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05])


def _prepare_unseen(spec: mujoco.MjSpec) -> None:
    prepare(spec)
    spec.compiler.discardvisual = True


def _check(spec: mujoco.MjSpec) -> None:
    named = {joint.name for joint in spec.joints}
    missing = [joint.mjcf_name for joint in select(G1_29) if joint.mjcf_name not in named]
    if missing:
        raise ValueError(f"expected the 29 joints of a G1, {len(missing)} are missing: {', '.join(missing[:3])} …")
    free = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    if [joint.parent.name for joint in free] != [ROOT_BODY]:
        raise ValueError(f"expected one free joint, that of the {ROOT_BODY}; came {len(free)}")


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
