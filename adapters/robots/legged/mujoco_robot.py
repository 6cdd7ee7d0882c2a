"""A simulated robot on legs: any MuJoCo model that has the joints of its table on a free root."""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from adapters.robots.legged import mjcf
from adapters.robots.legged.addresses import Addresses
from adapters.robots.legged.table import LeggedRobot
from station.assets import sha256
from station.errors import ConfigError
from station.protocols import FALL_TILT_RAD, Fall, Floats, JointTargets, RobotState
from station.rotations import rotate_inverse, tilt
from station.window import Window

log = logging.getLogger(__name__)

_BAD_STATE = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)


class LeggedMujoco:
    """A robot on legs in MuJoCo; `write` applies targets for one control period and advances the physics by it.

    Implements `station.protocols.SimulatedRobot`. Torques follow ``kp (q_target - q) - kd dq`` in every physics step,
    clipped to what its table says. Not thread safe.

    Args:
        robot: Its table.
        model: MJCF file with the joints of the table and a free joint.
        physics_dt_s: Physics step [s]; the stock simulations use 0.001, training 0.002.
        control_dt_s: Control period [s]; a whole number of physics steps.
        latency_steps: Control periods from `write` to the motors, which hold the joints where they are until then.
        armature: Rotor inertia of every joint in place of the model's [kg m^2]; 0 for the model's.
        viewer: Whether to open MuJoCo's window; needs a display.

    Raises:
        BadFile: no such file, or no such model.
        ConfigError: the period is not a whole number of steps.
        StationError: a viewer was asked for and there is no display.
    """

    def __init__(
        self,
        robot: LeggedRobot,
        model: Path,
        *,
        physics_dt_s: float = 0.002,
        control_dt_s: float = 0.02,
        latency_steps: int = 0,
        armature: float = 0.0,
        viewer: bool = False,
    ) -> None:
        self._robot, self._latency_steps = robot, latency_steps
        self._steps = _whole_steps(control_dt_s, physics_dt_s)
        self._path = Path(model)
        mujoco.set_mju_user_warning(_log_warning)  # else MuJoCo prints and writes MUJOCO_LOG.TXT where we stand
        self._model = mjcf.load(robot, self._path, is_drawn=viewer, armature=armature)
        self._model.opt.timestep = physics_dt_s
        self._data = mujoco.MjData(self._model)
        self._at = Addresses(robot, self._model)
        self._may_touch = _feet(self._model, robot.feet)
        self._start_q = np.array(robot.start_q, dtype=np.float64)
        self._kp, self._kd = np.zeros(len(robot.joints)), np.zeros(len(robot.joints))
        self._on_the_way: deque[JointTargets] = deque()
        self.reset()
        self._viewer = Window(self._model, self._data) if viewer else None

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The joints, in the order of the table."""
        return self._robot.joint_names

    @property
    def qpos(self) -> Floats:
        """Ground truth: root position [m], root quaternion wxyz, n joints [rad]; shape (7 + n,)."""
        return np.concatenate([self._data.qpos[self._at.root_q], self._data.qpos[self._at.q]])

    @property
    def time_s(self) -> float:
        """Simulated time since the last `reset` [s]."""
        return float(self._data.time)

    @property
    def joint_speeds(self) -> Floats:
        """Greatest speed of each joint, shape (n,) [rad/s]: what the motors can, the physics knows no such limit."""
        return np.array([joint.velocity_rad_s for joint in self._robot.joints])

    def reset(self) -> None:
        """Put the robot back on its feet, at rest, in the start pose."""
        self._on_the_way.clear()
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[self._at.root_q] = (0.0, 0.0, self._robot.start_height_m, 1.0, 0.0, 0.0, 0.0)
        self._data.qpos[self._at.q] = self._start_q
        self._data.ctrl[self._at.u] = self._start_q
        mujoco.mj_forward(self._model, self._data)

    def read(self) -> RobotState:
        """Return the state of the simulation; the gyro is free of noise and filters."""
        qpos, qvel = self._data.qpos, self._data.qvel
        root = qpos[self._at.root_q]
        return RobotState(
            mono_ns=time.monotonic_ns(),
            q=qpos[self._at.q],
            dq=qvel[self._at.v],
            quat_wxyz=root[3:].copy(),
            gyro=qvel[self._at.root_v[3:]],  # MuJoCo keeps the angular velocity of a free joint in the body's own frame
            root_pos=root[:3].copy(),
            root_lin_vel=rotate_inverse(root[3:], qvel[self._at.root_v[:3]]),
        )

    def write(self, targets: JointTargets) -> JointTargets:
        """Hold targets for one control period, or those that reach the motors now; return the ones that were sent.

        Raises:
            ValueError: a target or a gain is not finite.
        """
        if not (np.isfinite(targets.q).all() and np.isfinite(targets.kp).all() and np.isfinite(targets.kd).all()):
            raise ValueError("joint targets must be finite")
        arrived = self._arriving(targets)
        self._set_gains(arrived.kp, arrived.kd)
        self._data.ctrl[self._at.u] = arrived.q
        mujoco.mj_step(self._model, self._data, self._steps)
        if self._viewer is not None:
            self._viewer.sync()
        return targets

    def damp(self) -> None:
        """Stand still: no time passes in the simulation, so that a robot that is disarmed need not be caught.

        What was on its way to the motors is lost: it would move a robot that is armed again, however much later.
        """
        self._on_the_way.clear()

    def push(self, velocity_step: Floats) -> None:
        """Add to the linear velocity of the root in the world, shape (3,) [m/s]; joints keep their speeds, so the
        whole body moves off at once."""
        self._data.qvel[self._at.root_v[:3]] += velocity_step

    def fallen(self) -> Fall | None:
        """Return why the robot counts as fallen: a root beyond `FALL_TILT_RAD`, or ground under anything but the feet.

        Seen at the end of a control period: a touch that begins and ends within one is not. A root below its least
        height counts as one that touches: not every model has a shape there.
        """
        root = self._data.qpos[self._at.root_q]
        tilt_rad = float(tilt(root[3:]))
        touching = self._touching()
        least_m = self._robot.least_height_m
        if least_m and root[2] < least_m and self._robot.root not in touching:
            touching = (self._robot.root, *touching)
        if any(self._data.warning[kind].number for kind in _BAD_STATE):  # MuJoCo has then put the model back to zero
            return Fall(tilt_rad=math.pi, contacts=("unstable simulation",))
        return Fall(tilt_rad, touching) if touching or tilt_rad > FALL_TILT_RAD else None

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of this robot."""
        return {
            "backend": "mujoco",
            "mujoco": mujoco.__version__,
            "model": str(self._path),
            "model_sha256": sha256(self._path),
            "mass_kg": round(float(self._model.body_subtreemass[0]), 4),
            "physics_dt_s": float(self._model.opt.timestep),
            "control_dt_s": float(self._model.opt.timestep) * self._steps,
            "torque_clip_nm": list(self._robot.torques_nm),
            "pd": "engine servo, explicit (Euler)",
            "latency_steps": self._latency_steps,
            "armature": self._model.dof_armature[self._at.v].tolist(),
        }

    def close(self) -> None:
        """Close the window; a second call does nothing."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    def _arriving(self, sent: JointTargets) -> JointTargets:
        """Return what the motors get in this period when these targets are sent."""
        self._on_the_way.append(sent)
        if len(self._on_the_way) <= self._latency_steps:
            return JointTargets(self._data.qpos[self._at.q], sent.kp, sent.kd)
        return self._on_the_way.popleft()

    def _set_gains(self, kp: Floats, kd: Floats) -> None:
        if np.array_equal(kp, self._kp) and np.array_equal(kd, self._kd):
            return
        self._model.actuator_gainprm[self._at.u, 0] = kp
        self._model.actuator_biasprm[self._at.u, 1] = -np.asarray(kp)
        self._model.actuator_biasprm[self._at.u, 2] = -np.asarray(kd)
        self._kp, self._kd = np.array(kp), np.array(kd)

    def _touching(self) -> tuple[str, ...]:
        """Names of the bodies other than the feet that touch the ground (the geoms of the world)."""
        contacts = self._data.contact
        bodies = self._model.geom_bodyid[contacts.geom[contacts.dist <= 0]]
        bodies = bodies[(bodies == 0).sum(axis=1) == 1].max(axis=1, initial=0)
        return tuple(sorted({self._model.body(body).name for body in bodies if not self._may_touch[body]}))


def _log_warning(text: str) -> None:
    log.warning("MuJoCo: %s", text)


def _whole_steps(control_dt_s: float, physics_dt_s: float) -> int:
    steps = round(control_dt_s / physics_dt_s) if physics_dt_s > 0 else 0
    if steps < 1 or abs(steps * physics_dt_s - control_dt_s) > 1e-9:
        raise ConfigError(
            f"physics_dt_s {physics_dt_s}: expected a step that fits the control period of {control_dt_s} s "
            "a whole number of times, for example 0.001 or 0.002"
        )
    return steps


def _feet(model: mujoco.MjModel, endings: tuple[str, ...]) -> NDArray[np.bool_]:
    """Which bodies may touch the ground: the feet and what hangs on them; shape (nbody,)."""
    feet = {body for body in range(model.nbody) if model.body(body).name.endswith(endings)}
    return np.array([_is_part_of(model, body, feet) for body in range(model.nbody)])


def _is_part_of(model: mujoco.MjModel, body: int, roots: set[int]) -> bool:
    while body and body not in roots:
        body = int(model.body_parentid[body])
    return body in roots
