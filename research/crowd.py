"""Many simulated robots on legs side by side, each with a body of its own, stepped by threads."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from adapters.robots.legged import mjcf
from adapters.robots.legged.addresses import Addresses
from adapters.robots.legged.table import LeggedRobot
from research import recipe
from station.protocols import Floats

CONTROL_DT_S = 0.02


@dataclass(frozen=True, slots=True)
class States:
    """What n robots of m joints measured, one row each; units and frames as in `station.protocols.RobotState`.

    Attributes:
        lin_vel: Velocity of the root in the world's frame, shape (n, 3) [m/s].
        bias: What gravity and speed pull at the joints, shape (n, m) [N m]; no robot measures it.
    """

    q: Floats
    dq: Floats
    quat_wxyz: Floats
    gyro: Floats
    root_pos: Floats
    lin_vel: Floats
    bias: Floats


class Crowd:
    """n robots; row i of every array is robot i's.

    Args:
        robot: What kind they are.
        models: Robot models (MJCF), dealt out in turn: three bodies of the first, one of the second, and so on.
        kp, kd: Gains of the joints, shape (m,).
        config: Their number and how they differ.
        rng: Draws the bodies.
        threads: Threads that step them.
        trunk: Body that carries the payload; "" for the root.
    """

    def __init__(
        self,
        robot: LeggedRobot,
        models: Sequence[Path],
        kp: Floats,
        kd: Floats,
        config: recipe.Crowd,
        rng: np.random.Generator,
        threads: int,
        trunk: str = "",
    ) -> None:
        self._robot, self._trunk = robot, trunk or robot.root
        bodies = []
        for number in range(config.bodies):
            path = models[1] if len(models) > 1 and number % 4 == 3 else models[0]
            bodies.append(self._varied(path, kp, kd, config, rng, is_nominal=number < config.nominal))
        self._models = [bodies[number % len(bodies)] for number in range(config.robots)]
        self._data = [mujoco.MjData(model) for model in self._models]
        self._substeps = round(CONTROL_DT_S / config.physics_dt_s)
        self._at = [self._addresses(model) for model in self._models]
        self._pool = ThreadPoolExecutor(threads)
        chunks = np.array_split(np.arange(config.robots), threads * 4)
        self._chunks = [chunk.tolist() for chunk in chunks if len(chunk)]
        for number in range(config.robots):
            self.restart(number)

    def __len__(self) -> int:
        return len(self._data)

    @property
    def start_q(self) -> Floats:
        """Joints at the start, shape (m,) [rad]."""
        return np.array(self._robot.start_q, dtype=np.float64)

    def restart(self, number: int) -> None:
        """Put a robot back on its feet, at rest."""
        model, data, at = self._models[number], self._data[number], self._at[number]
        mujoco.mj_resetData(model, data)
        data.qpos[at.root_q] = (0.0, 0.0, self._robot.start_height_m, 1.0, 0.0, 0.0, 0.0)
        data.qpos[at.q] = self._robot.start_q
        data.ctrl[at.u] = self._robot.start_q
        mujoco.mj_forward(model, data)

    def push(self, number: int, velocity: Floats) -> None:
        """Change the velocity of a root in the world's plane at once, by shape (2,) [m/s]."""
        self._data[number].qvel[self._at[number].root_v[:2]] += velocity

    def read(self) -> States:
        """Return the states of all."""
        end = 6 + len(self._robot.joints)
        qpos = np.array([data.qpos[: end + 1] for data in self._data])
        qvel = np.array([data.qvel[:end] for data in self._data])
        bias = np.array([data.qfrc_bias[6:end] for data in self._data])
        return States(qpos[:, 7:], qvel[:, 6:], qpos[:, 3:7], qvel[:, 3:6], qpos[:, :3], qvel[:, :3], bias)

    def step(self, before: Floats, targets: Floats, late: Floats) -> None:
        """Advance all by a control period.

        Args:
            before: Targets of the period before, shape (n, m) [rad].
            targets: Targets of this one, shape (n, m) [rad].
            late: Part of the period until the new targets reach the motors, shape (n,), 0 to 1.
        """

        def advance(numbers: list[int]) -> None:
            for number in numbers:
                model, data, u = self._models[number], self._data[number], self._at[number].u
                old = round(late[number] * self._substeps)
                if old:
                    data.ctrl[u] = before[number]
                    mujoco.mj_step(model, data, old)
                if old < self._substeps:
                    data.ctrl[u] = targets[number]
                    mujoco.mj_step(model, data, self._substeps - old)

        list(self._pool.map(advance, self._chunks))

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()

    def _addresses(self, model: mujoco.MjModel) -> Addresses:
        """Return where the robot's parts stand in a model, in which nothing else may come first."""
        found = Addresses(self._robot, model)
        # `read` takes rows whole.
        if found.q.tolist() != list(range(7, 7 + len(self._robot.joints))) or found.root_q[0] != 0:
            raise ValueError(
                f"expected the root first, then the joints in the order of the {self._robot.title}'s table"
            )
        return found

    def _varied(
        self, path: Path, kp: Floats, kd: Floats, config: recipe.Crowd, rng: np.random.Generator, *, is_nominal: bool
    ) -> mujoco.MjModel:
        """Return a body: that of the file, or one that differs from it as real ones do."""
        model = mjcf.load(self._robot, path, is_drawn=False)
        model.opt.timestep = config.physics_dt_s
        count = len(self._robot.joints)
        gains = np.ones(count) if is_nominal else 1 + rng.uniform(-1, 1, count) * config.gain_spread
        at = self._addresses(model)
        model.actuator_gainprm[at.u, 0] = kp * gains
        model.actuator_biasprm[at.u, 1] = -kp * gains
        model.actuator_biasprm[at.u, 2] = -kd * gains
        if is_nominal:
            return model
        scale = 1 + rng.uniform(-1, 1, model.nbody) * config.mass_spread
        trunk = model.body(self._trunk).id
        scale[trunk] += rng.uniform(0, config.payload_kg) / model.body_mass[trunk]
        model.body_mass *= scale
        model.body_inertia *= scale[:, None]
        model.body_ipos[trunk] += rng.uniform(-1, 1, 3) * config.com_shift_m
        model.geom_friction[:, 0] = rng.uniform(*config.friction)
        if any(config.armature):
            model.dof_armature[at.v] = np.exp(rng.uniform(*np.log(config.armature)))
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model
