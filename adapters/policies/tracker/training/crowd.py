"""Many simulated G1s side by side, each with a body of its own, stepped by threads."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from adapters.policies.tracker.training import recipe
from adapters.robots.g1.joints import G1_29
from adapters.robots.g1.mujoco_g1 import START_Q, START_ROOT_POS
from adapters.robots.legged import mjcf
from adapters.robots.legged.addresses import Addresses
from adapters.robots.legged.unitree import G1
from station.protocols import Floats

CONTROL_DT_S = 0.02
_TORSO = "torso_link"


@dataclass(frozen=True, slots=True)
class States:
    """What n robots measured, one row each; units and frames as in `station.protocols.RobotState`.

    Attributes:
        bias: What gravity and speed pull at the joints, shape (n, 29) [N m]; no robot measures it.
    """

    q: Floats
    dq: Floats
    quat_wxyz: Floats
    gyro: Floats
    root_pos: Floats
    bias: Floats


class Crowd:
    """n robots; row i of every array is robot i's.

    Args:
        models: Robot models (MJCF), dealt out in turn: three bodies of the first, one of the second, and so on.
        kp, kd: Gains of the joints, shape (29,).
        config: Their number and how they differ.
        rng: Draws the bodies.
        threads: Threads that step them.
    """

    def __init__(
        self,
        models: Sequence[Path],
        kp: Floats,
        kd: Floats,
        config: recipe.Crowd,
        rng: np.random.Generator,
        threads: int,
    ) -> None:
        bodies = []
        for number in range(config.bodies):
            path = models[1] if len(models) > 1 and number % 4 == 3 else models[0]
            bodies.append(_varied(path, kp, kd, config, rng, is_nominal=number < config.nominal))
        self._models = [bodies[robot % len(bodies)] for robot in range(config.robots)]
        self._data = [mujoco.MjData(model) for model in self._models]
        self._substeps = round(CONTROL_DT_S / config.physics_dt_s)
        self._at = [_addresses(model) for model in self._models]
        self._pool = ThreadPoolExecutor(threads)
        chunks = np.array_split(np.arange(config.robots), threads * 4)
        self._chunks = [chunk.tolist() for chunk in chunks if len(chunk)]
        for robot in range(config.robots):
            self.restart(robot)

    def __len__(self) -> int:
        return len(self._data)

    def restart(self, robot: int) -> None:
        """Put a robot back on its feet, at rest."""
        model, data, at = self._models[robot], self._data[robot], self._at[robot]
        mujoco.mj_resetData(model, data)
        data.qpos[at.root_q] = (*START_ROOT_POS, 1.0, 0.0, 0.0, 0.0)
        data.qpos[at.q] = START_Q
        data.ctrl[at.u] = START_Q
        mujoco.mj_forward(model, data)

    def push(self, robot: int, velocity: Floats) -> None:
        """Change the velocity of a root in the world's plane at once, by shape (2,) [m/s]."""
        self._data[robot].qvel[self._at[robot].root_v[:2]] += velocity

    def read(self) -> States:
        """Return the states of all."""
        qpos = np.array([data.qpos[:36] for data in self._data])
        qvel = np.array([data.qvel[:35] for data in self._data])
        bias = np.array([data.qfrc_bias[6:35] for data in self._data])
        return States(qpos[:, 7:], qvel[:, 6:], qpos[:, 3:7], qvel[:, 3:6], qpos[:, :3], bias)

    def step(self, before: Floats, targets: Floats, late: Floats) -> None:
        """Advance all by a control period.

        Args:
            before: Targets of the period before, shape (n, 29) [rad].
            targets: Targets of this one, shape (n, 29) [rad].
            late: Part of the period until the new targets reach the motors, shape (n,), 0 to 1.
        """

        def advance(robots: list[int]) -> None:
            for robot in robots:
                model, data, u = self._models[robot], self._data[robot], self._at[robot].u
                old = round(late[robot] * self._substeps)
                if old:
                    data.ctrl[u] = before[robot]
                    mujoco.mj_step(model, data, old)
                if old < self._substeps:
                    data.ctrl[u] = targets[robot]
                    mujoco.mj_step(model, data, self._substeps - old)

        list(self._pool.map(advance, self._chunks))

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()


def _addresses(model: mujoco.MjModel) -> Addresses:
    """Return where a G1's parts stand in a model, in which nothing else may come first."""
    found = Addresses(G1, model)
    if found.q.tolist() != list(range(7, 36)) or found.root_q[0] != 0:  # `Crowd.read` takes rows whole
        raise ValueError("expected the root first, then the 29 joints in Unitree's motor order")
    return found


def _varied(
    path: Path, kp: Floats, kd: Floats, config: recipe.Crowd, rng: np.random.Generator, *, is_nominal: bool
) -> mujoco.MjModel:
    """Return a body: that of the file, or one that differs from it as real ones do."""
    model = mjcf.load(G1, path, is_drawn=False)
    model.opt.timestep = config.physics_dt_s
    gains = np.ones(len(G1_29)) if is_nominal else 1 + rng.uniform(-1, 1, len(G1_29)) * config.gain_spread
    u = _addresses(model).u
    model.actuator_gainprm[u, 0] = kp * gains
    model.actuator_biasprm[u, 1] = -kp * gains
    model.actuator_biasprm[u, 2] = -kd * gains
    if is_nominal:
        return model
    scale = 1 + rng.uniform(-1, 1, model.nbody) * config.mass_spread
    torso = model.body(_TORSO).id
    scale[torso] += rng.uniform(0, config.payload_kg) / model.body_mass[torso]
    model.body_mass *= scale
    model.body_inertia *= scale[:, None]
    model.body_ipos[torso] += rng.uniform(-1, 1, 3) * config.com_shift_m
    model.geom_friction[:, 0] = rng.uniform(*config.friction)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model
