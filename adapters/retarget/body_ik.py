"""Joints of a G1 that do what is asked of its links: differential inverse kinematics, warm-started, within limits.

`mink` states the problem and integrates; each step is a small quadratic program, solved by DAQP.
"""

from __future__ import annotations

import importlib
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from adapters.motions.builtin.body import STANDING_HEIGHT_M, STANDING_Q
from adapters.retarget.arm_rescue import ArmRescue
from adapters.retarget.bone_frames import to_quats
from adapters.retarget.scaling import Aim
from adapters.retarget.weights import Weights
from adapters.robots.g1 import joints as g1
from adapters.robots.g1.joints import G1_29
from station import assets
from station.errors import StationError
from station.protocols import Floats

MODEL = "builtin:g1.xml"
START = np.concatenate([[0.0, 0.0, STANDING_HEIGHT_M, 1.0, 0.0, 0.0, 0.0], STANDING_Q])
"""Where the search begins when nothing is known: standing, shape (36,)."""


_FIRST_REACH = np.full(6 + len(G1_29), 0.15)  # per round of a first frame: no arm passes through another unseen


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """How far a frame may be from the last one.

    Attributes:
        joint_rad_s: Greatest speed of a joint; the motor's own where that is less [rad/s].
        root_mps, root_rad_s: Greatest speeds of the root along and about each of its axes [m/s], [rad/s].
        longest_s: A frame is never given more time than this [s], however long nothing came.
    """

    joint_rad_s: float = 15.0
    root_mps: float = 2.5
    root_rad_s: float = 5.0
    longest_s: float = 0.03


class BodyIK:
    """Finds the joints of a G1, frame after frame.

    Args:
        weights: What matters how much.
        limits: How far a frame may be from the last one.
        rounds: Steps of the search per frame; the first frame after a reset gets `first_rounds`.
        is_clear: Whether forearms and hands are kept clear of the body and of each other.

    Raises:
        StationError: the extra ``retarget`` is not installed.
    """

    def __init__(
        self,
        *,
        weights: Weights | None = None,
        limits: Limits | None = None,
        rounds: int = 2,
        first_rounds: int = 60,
        is_clear: bool = True,
    ) -> None:
        self._mink, model = _libraries(), _model()
        from adapters.retarget.ik_tasks import ARMS, Box, Clearance, tasks_for

        self._limits = limits or Limits()
        self._rounds, self._first_rounds = rounds, first_rounds
        self._weights = weights or Weights()
        self._configuration = self._mink.Configuration(model, START)
        self._tasks = tasks_for(model, self._weights)
        self._speeds = np.concatenate(
            [
                np.full(3, self._limits.root_mps),
                np.full(3, self._limits.root_rad_s),
                np.minimum(g1.velocity(G1_29), self._limits.joint_rad_s),
            ]
        )
        self._arms = ARMS
        self.rescues = (ArmRescue(), ArmRescue())
        """Of the left arm and of the right one."""
        self._box = Box(model, g1.lower(G1_29), g1.upper(G1_29))
        self._bounds = [self._box, Clearance(model)] if is_clear else [self._box]
        self.reset()

    def reset(self, qpos: Floats | None = None) -> None:
        """Begin anew: the next frame is searched for from here without a limit on speeds, shape (36,)."""
        self._configuration.update(START if qpos is None else qpos)
        self._is_first = True
        for side, rescue in enumerate(self.rescues):
            rescue.reset()
            self._tasks.free(side, False)

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of the search: weights and limits."""
        return {"weights": asdict(self._weights), "limits": asdict(self._limits), "rounds": self._rounds}

    def step(self, aim: Aim, dt_s: float) -> Floats:
        """Return root position [m], root quaternion wxyz and the 29 joints [rad], shape (36,).

        Args:
            aim: What is asked of the links; finite.
            dt_s: Time since the last frame [s].
        """
        self._tasks.aim_at(aim)
        if self._is_first:
            self._place(aim)
            for _ in range(self._first_rounds):
                self._box.begin(self._configuration.q, _FIRST_REACH)
                self._search(1)
            self._is_first = False
        else:
            time_s = min(max(dt_s, 0.0), self._limits.longest_s)
            self._box.begin(self._configuration.q, self._lead_arms(aim, time_s) * time_s)
            self._search(self._rounds)
        return np.array(self._configuration.q)

    def _lead_arms(self, aim: Aim, time_s: float) -> Floats:
        """Lead back an arm that is caught; return the greatest speeds of this frame, shape (35,)."""
        speeds, q = self._speeds, self._configuration.q[7:]
        for side, rescue in enumerate(self.rescues):
            joints, before = self._arms[side], rescue.way
            away_rad = float(np.abs(q[joints] - STANDING_Q[joints]).max())
            found = self._tasks.upper_arms[side].direction(self._configuration)
            way = rescue.step(aim.upper_arms[side], found, away_rad, time_s)
            if way != before:
                self._tasks.free(side, way == "frees")
            if way != "follows":
                speeds = speeds.copy()
                speeds[6 + joints] = np.minimum(speeds[6 + joints], rescue.rules.speed_rad_s)
        return speeds

    def _place(self, aim: Aim) -> None:
        """Put the root where it is asked to be; from a far one the search would take a long way round."""
        q = self._configuration.q.copy()
        q[:3], q[3:7] = aim.pelvis, to_quats(aim.pelvis_turn)
        self._configuration.update(q)

    def _search(self, rounds: int) -> None:
        for _ in range(rounds):
            try:
                velocity = self._solved(self._bounds)
            except self._mink.NoSolutionFound:  # what shall come apart cannot within its speeds; the box is feasible
                velocity = self._solved([self._box])
            self._configuration.update(self._box.inside(self._configuration.integrate(velocity, 1.0)))

    def _solved(self, bounds: list[Any]) -> Floats:
        found = self._mink.solve_ik(
            self._configuration, self._tasks.all, 1.0, "daqp", self._weights.damping, limits=bounds
        )
        return np.asarray(found)


def _libraries() -> Any:
    try:
        importlib.import_module("daqp")
        return importlib.import_module("mink")
    except ImportError as error:
        raise StationError(
            f"whole-body retargeting needs {error.name}; install the extra: pip install 'teleop-station[retarget]'"
        ) from error


def _model() -> Any:
    import mujoco

    return mujoco.MjModel.from_xml_path(str(assets.resolve(MODEL)))
