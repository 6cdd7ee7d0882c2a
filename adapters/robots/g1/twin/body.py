"""The body of a robot twin: MuJoCo at 1 kHz, motors that hold their command, a gantry, and what its sensors say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from adapters.robots.g1.twin.faults import G1Faults
from adapters.robots.legged import mjcf
from adapters.robots.legged.addresses import Addresses
from adapters.robots.legged.unitree import G1
from station.protocols import Floats
from station.rotations import multiply, roll_pitch_yaw, rotate_inverse, tilt

STEP_S = 0.001
JOINTS = len(G1.joints)
FALLEN_M = 0.35
"""A pelvis below it has fallen [m]: motions squat down to 0.4."""

_HUNG_M = 0.12  # feet above the ground
_ROPE_N_PER_M, _ROPE_N_S_PER_M = 8000.0, 800.0  # as stiff as a strap: it gives 4 cm under the robot's weight
_STEADIES_N_S_PER_M = 60.0  # somebody has a hand on the robot that hangs: it swings no more after seconds
_ROPE_MOVES_M_S = 0.1  # as fast as a hand winch
# A slack one leaves room for the deepest squat: one of 0.15 m carried half the robot in it, and hid what its motors do.
_ROPE_FROM_STANDING_M = {"hung": -_HUNG_M, "down": -0.02, "slack": 0.47}

# A motor warms by the square of its torque and cools towards the room: 20 minutes of half its torque bring it to 60 °C.
_ROOM_C, _COOLS_S, _WARMS_C = 25.0, 600.0, 140.0
_CASING_SHARE = 0.6

_GEARS_N_M_S = 0.5  # what a motor without current resists by: a limb that hangs swings once or twice


@dataclass(slots=True)
class Held:
    """The command that the motors hold, n each: torque = tau + kp (q - q_measured) + kd (dq - dq_measured)."""

    q: Floats = field(default_factory=lambda: np.zeros(JOINTS))
    dq: Floats = field(default_factory=lambda: np.zeros(JOINTS))
    tau: Floats = field(default_factory=lambda: np.zeros(JOINTS))
    kp: Floats = field(default_factory=lambda: np.zeros(JOINTS))
    kd: Floats = field(default_factory=lambda: np.zeros(JOINTS))


@dataclass(frozen=True, slots=True)
class Measured:
    """What the sensors say at one instant; joints in the order of the motors."""

    q: Floats
    dq: Floats
    ddq: Floats
    tau: Floats
    quat_wxyz: Floats
    gyro: Floats
    accelerometer: Floats
    rpy: Floats
    winding_c: Floats
    casing_c: Floats


class TwinBody:
    """A G1 with 29 motors.

    Args:
        model: MJCF file.
        absent: Motors that it does not have: their joints are bolted where they are at the start.
        seed: Of offsets and noise.

    Attributes:
        held: What the motors hold.
        falls: How often the pelvis fell below `FALLEN_M`.
    """

    def __init__(self, model: Path, *, absent: Sequence[int] = (), seed: int = 0) -> None:
        self._model = mjcf.load(G1, model, is_drawn=False)
        self._model.opt.timestep = STEP_S
        self._data = mujoco.MjData(self._model)
        self._at = Addresses(G1, self._model)
        self._torso = self._model.body("torso_link").id
        self._model.actuator_gainprm[self._at.u, 0] = 1.0  # what the motors are to do is computed in `_set`
        bolted = self._at.v[list(absent)]
        self._model.dof_armature[bolted] = 100.0  # so much inertia that nothing moves it
        self._model.dof_damping[bolted] = 5000.0
        self._chance = np.random.default_rng(seed)
        self._offsets = self._chance.uniform(-1.0, 1.0, JOINTS)
        self._limits_nm = np.array(G1.torques_nm)
        self.held = Held()
        self._winding_c = np.full(JOINTS, _ROOM_C)
        self._faults = G1Faults()
        self._counts = np.ones(JOINTS)  # -1 of a joint that counts the other way round
        self._pushed = self._faults.push_m_s
        self.falls, self._is_down = 0, False
        self._yaw_rad = 0.0
        standing = G1.start_height_m
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[self._at.root_q] = (0.0, 0.0, standing, 1.0, 0.0, 0.0, 0.0)
        mujoco.mj_forward(self._model, self._data)
        self._anchor = self._data.xpos[self._torso] + (0.0, 0.0, 1.5)
        self._standing_rope_m = float(self._anchor[2] - self._data.xpos[self._torso][2])
        self._rope_m = self._distance_m = self._standing_rope_m - _HUNG_M
        self._data.qpos[self._at.root_q[2]] = standing + _HUNG_M
        mujoco.mj_forward(self._model, self._data)

    @property
    def qpos(self) -> Floats:
        """Ground truth: root position [m], root quaternion wxyz, 29 joints [rad]; shape (36,)."""
        return np.concatenate([self._data.qpos[self._at.root_q], self._data.qpos[self._at.q]])

    @property
    def height_m(self) -> float:
        """Height of the pelvis above the ground [m]."""
        return float(self._data.qpos[self._at.root_q[2]])

    @property
    def tilt_rad(self) -> float:
        """Angle between the pelvis' up and the world's [rad]."""
        return float(tilt(self._data.qpos[self._at.root_q[3:]]))

    def change(self, faults: G1Faults) -> None:
        """Have other faults from now on."""
        self._faults = faults
        self._counts = np.where([name in faults.reversed_joints for name in G1.joint_names], -1.0, 1.0)
        if faults.push_m_s != self._pushed:
            self._pushed = faults.push_m_s
            self._data.qvel[self._at.root_v[:2]] += faults.push_m_s

    def step(self, count: int) -> None:
        """Advance by a number of steps of `STEP_S`, under the command that is held."""
        held, model, data = self.held, self._model, self._data
        is_limp = (held.kp == 0.0) & (held.kd == 0.0)
        model.actuator_biasprm[self._at.u, 1] = -held.kp
        model.actuator_biasprm[self._at.u, 2] = -np.where(is_limp, _GEARS_N_M_S, held.kd)
        data.ctrl[self._at.u] = held.kp * held.q + held.kd * held.dq + held.tau
        for _ in range(count):
            self._pull(STEP_S)
            mujoco.mj_step(model, data)
        self._warm(count * STEP_S)
        self._yaw_rad += self._faults.yaw_drift_rad_s * count * STEP_S
        is_down = self.height_m < FALLEN_M
        self.falls += is_down and not self._is_down
        self._is_down = is_down

    def measure(self) -> Measured:
        """Return what the sensors say now."""
        faults, data = self._faults, self._data
        quat, gyro = data.qpos[self._at.root_q[3:]], data.qvel[self._at.root_v[3:]]
        seen = _mounted(quat, faults.imu_roll_rad, faults.imu_pitch_rad, faults.imu_yaw_rad + self._yaw_rad)
        force = data.qacc[self._at.root_v[:3]] + (0.0, 0.0, 9.81)
        dq = data.qvel[self._at.v]
        if faults.velocity_noise_rad_s:
            dq = dq + self._chance.normal(0.0, faults.velocity_noise_rad_s, JOINTS)
        winding = self._winding_c.copy()
        for name, value in faults.winding_c.items():
            winding[G1.joint_names.index(name)] = value
        return Measured(
            q=self._counts * data.qpos[self._at.q] + faults.encoder_offset_rad * self._offsets,
            dq=self._counts * dq,
            ddq=self._counts * data.qacc[self._at.v],
            tau=self._counts * data.actuator_force[self._at.u],
            quat_wxyz=seen,
            gyro=gyro + faults.gyro_bias_rad_s,
            accelerometer=rotate_inverse(quat, force),
            rpy=np.asarray(roll_pitch_yaw(seen)),
            winding_c=winding,
            casing_c=_ROOM_C + _CASING_SHARE * (winding - _ROOM_C),
        )

    def _pull(self, dt_s: float) -> None:
        """Have the gantry's rope pull, and let it out or take it in."""
        force = self._data.xfrc_applied[self._torso]
        force[:] = 0.0
        if self._faults.gantry == "off":
            return
        wanted_m = self._standing_rope_m + _ROPE_FROM_STANDING_M[self._faults.gantry]
        self._rope_m += float(np.clip(wanted_m - self._rope_m, -_ROPE_MOVES_M_S * dt_s, _ROPE_MOVES_M_S * dt_s))
        if self._faults.gantry == "slack":  # it is on wheels, and goes with the robot
            self._anchor[:2] = self._data.xpos[self._torso][:2]
        along = self._anchor - self._data.xpos[self._torso]
        distance = float(np.linalg.norm(along))
        if distance <= self._rope_m:
            self._distance_m = distance
            return
        away_m_s, self._distance_m = (distance - self._distance_m) / dt_s, distance
        pull_n = _ROPE_N_PER_M * (distance - self._rope_m) + _ROPE_N_S_PER_M * away_m_s
        force[:3] = max(0.0, pull_n) * along / distance
        force[:2] -= _STEADIES_N_S_PER_M * self._data.qvel[self._at.root_v[:2]]

    def _warm(self, dt_s: float) -> None:
        load = (self._data.actuator_force[self._at.u] / self._limits_nm) ** 2
        self._winding_c += (load * _WARMS_C - (self._winding_c - _ROOM_C)) * (dt_s / _COOLS_S)


def _mounted(quat: Floats, roll: float, pitch: float, yaw: float) -> Floats:
    """Return what an IMU that is mounted, or has drifted, by these angles [rad] says of an orientation."""
    if not (roll or pitch or yaw):
        return quat.copy()
    turned = multiply(_about(2, yaw), quat)
    return np.asarray(multiply(turned, multiply(_about(1, pitch), _about(0, roll))))


def _about(axis: int, angle_rad: float) -> NDArray[np.float64]:
    quat = np.zeros(4)
    quat[0], quat[1 + axis] = np.cos(angle_rad / 2), np.sin(angle_rad / 2)
    return quat
