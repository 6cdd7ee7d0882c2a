"""Joints of a G1 that do what is asked of its links: differential inverse kinematics, warm-started, within limits.

`mink` states the problem and integrates; each step is a small quadratic program, solved by DAQP.
"""

from __future__ import annotations

import importlib
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from adapters.motions.builtin.body import STANDING_HEIGHT_M, STANDING_Q
from adapters.retarget.bone_frames import to_quats
from adapters.retarget.ik_tasks import Weights
from adapters.retarget.scaling import LinkTargets
from adapters.robots.g1 import joints as g1
from adapters.robots.g1.joints import G1_29
from station import assets
from station.errors import StationError
from station.protocols import Floats

MODEL = "builtin:g1.xml"
START = np.concatenate([[0.0, 0.0, STANDING_HEIGHT_M, 1.0, 0.0, 0.0, 0.0], STANDING_Q])
"""Where the search begins when nothing is known: standing, shape (36,)."""


_FIRST_REACH = np.full(6 + len(G1_29), 0.15)  # per round of a first frame: no arm passes through another unseen

Way = Literal["follows", "frees", "returns"]


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
        self.speeds = np.concatenate(
            [
                np.full(3, self._limits.root_mps),
                np.full(3, self._limits.root_rad_s),
                np.minimum(g1.velocity(G1_29), self._limits.joint_rad_s),
            ]
        )
        """Greatest speeds of the root along the world's and about its own axes, and of the joints, shape (35,)."""
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

    def step(self, aim: LinkTargets, dt_s: float) -> Floats:
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

    def _lead_arms(self, aim: LinkTargets, time_s: float) -> Floats:
        """Lead back an arm that is caught; return the greatest speeds of this frame, shape (35,)."""
        speeds, q = self.speeds, self._configuration.q[7:]
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

    def _place(self, aim: LinkTargets) -> None:
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


@dataclass(frozen=True, slots=True, kw_only=True)
class RescueRules:
    """When an arm is led back.

    Attributes:
        caught_rad: An upper arm that points so far away from where it shall ...
        caught_s: ... for so long is caught [s]; an arm that only catches up with a leap is there sooner.
        free_rad: Every joint of the arm so near the standing pose: it is free.
        good_rad: So near where it shall point: it follows again.
        longest_s: No way takes longer [s].
        other_rad: Where freeing has not helped, it is not tried again before the arm is asked to point elsewhere.
        speed_rad_s: Greatest speed of the arm's joints on the way [rad/s]: no command asks for these motions.
    """

    caught_rad: float = 0.6
    caught_s: float = 0.4
    free_rad: float = 0.3
    good_rad: float = 0.2
    longest_s: float = 2.0
    other_rad: float = 0.5
    speed_rad_s: float = 5.0


class ArmRescue:
    """Watches one arm; says when it follows, frees itself, and returns.

    Args:
        rules: When it is led back.
    """

    def __init__(self, rules: RescueRules | None = None) -> None:
        self.rules = rules or RescueRules()
        self.reset()

    def reset(self) -> None:
        """Forget everything: the arm follows."""
        self.way: Way = "follows"
        self.rescues = 0
        """How often the arm was led back."""
        self._since_s = 0.0
        self._tried: Floats | None = None

    def step(self, wanted: Floats, found: Floats, away_rad: float, dt_s: float) -> Way:
        """Return what the arm does in the next frame.

        Args:
            wanted: Where the upper arm shall point, a unit vector, shape (3,).
            found: Where it points, likewise.
            away_rad: How far the arm's joints are from the standing pose, the greatest [rad].
            dt_s: Time since the last frame [s].
        """
        rules, off = self.rules, _angle(wanted, found)
        self._since_s += dt_s
        if self.way == "follows":
            if off < rules.good_rad:
                self._tried = None
            was_tried = self._tried is not None and _angle(self._tried, wanted) < rules.other_rad
            if off < rules.caught_rad or was_tried:
                self._since_s = 0.0
            elif self._since_s > rules.caught_s:
                self._tried = wanted.copy()
                self.rescues += 1
                self._go("frees")
        elif self.way == "frees":
            if away_rad < rules.free_rad or self._since_s > rules.longest_s:
                self._go("returns")
        elif off < rules.good_rad or self._since_s > rules.longest_s:
            self._go("follows")
        return self.way

    def _go(self, way: Way) -> None:
        self.way, self._since_s = way, 0.0


def _angle(first: Floats, second: Floats) -> float:
    return float(np.arccos(np.clip(first @ second, -1.0, 1.0)))
