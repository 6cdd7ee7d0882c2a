"""One case on one rig."""

from __future__ import annotations

import math
import time
from collections import deque
from functools import lru_cache, singledispatch
from typing import Any

import msgspec
import numpy as np

from station import registry
from station.contract import names_of
from station.control.control import ControlStep, StepRecord
from station.control.parted_path import samples_of
from station.control.rig import Rig, RigConfig, build
from station.control.tracking import TrackingError
from station.errors import ConfigError
from station.protocols import Fall, Floats, JointTargets, Motion, RobotState, SimulatedRobot
from station.rehearse import rehearse
from station.rotations import roll_pitch_yaw, tilt
from station.suite import commands
from station.suite.cases import Arms, Case, Cut, Push, Stand, Track
from station.suite.commands import Commands
from station.suite.outcome import Drift, FallOutcome, Outcome
from station.suite.promise import ENTER_S, SETTLED_S

_ROUNDING = 1e-9


def run_case(case: Case, config: RigConfig) -> Outcome:
    """Run a case to its end, or to a fall; what a rig and a clip are made of is loaded once per process.

    Raises:
        ConfigError: the robot is not simulated, or the policy's commands have no arms.
        StationError: something cannot be loaded.
    """
    started_s = time.perf_counter()
    rig = _rig(msgspec.json.encode(config))
    watch = _run(case, rig)
    return Outcome(
        case=case.name,
        group=case.group,
        falls=tuple(watch.falls),
        joint_error_rad=watch.error.mean_joint_error_rad,
        lean_rad=watch.lean_rad,
        drift=watch.drift() if isinstance(case, Stand) and not watch.falls else None,
        simulated_s=watch.ticks * rig.period_s,
        wall_s=time.perf_counter() - started_s,
    )


class _Watch:
    """Sees every step of a run."""

    def __init__(self, rig: Rig) -> None:
        self.ticks = 0
        self.falls: list[FallOutcome] = []
        self.lean_rad = 0.0
        self.error = TrackingError(names_of(rig.command_format.elements), rig.robot.joint_names)
        self._period_s = rig.period_s
        self._places: list[Floats] = []  # x, y [m] and yaw [rad] of the root

    def see(self, record: StepRecord, *, counts: bool) -> None:
        """Add a step; `counts` tells whether its joint error does."""
        state, fall, gate = record.state, record.fall, record.decision.state
        if counts and gate == "tracking":
            self.error.add(state.q, record.decision.vector)
        self._places.append(_place(state))
        self.lean_rad = max(self.lean_rad, float(tilt(state.quat_wxyz)))
        self.ticks += 1
        if fall is not None:
            self.lean_rad = max(self.lean_rad, fall.tilt_rad)
            at_s = self.ticks * self._period_s
            self.falls.append(FallOutcome(at_s=at_s, lean_rad=fall.tilt_rad, contacts=fall.contacts, gate=gate))

    def drift(self) -> Drift:
        settled = min(round(SETTLED_S / self._period_s), len(self._places) // 2)
        places = np.array(self._places[settled:])
        away_m = np.hypot(*(places[:, :2] - places[0, :2]).T)
        yaw = np.unwrap(places[:, 2])
        return Drift(end_m=float(away_m[-1]), greatest_m=float(away_m.max()), yaw_rad=float(yaw[-1] - yaw[0]))


@singledispatch
def _run(case: Case, rig: Rig) -> _Watch:
    raise TypeError(f"no way to run a {type(case).__name__}")


@_run.register
def _(case: Stand, rig: Rig) -> _Watch:
    return _drive(_late(rig, case.late_s), commands.silence, case.seconds)


@_run.register
def _(case: Track, rig: Rig) -> _Watch:
    watch = _Watch(rig)
    rehearse(
        _clip(case.clip), rig.policy, _late(rig, case.late_s).robot, rig.command_format, period_s=rig.period_s,
        on_step=lambda frame, record: watch.see(record, counts=frame.phase == "playing"),
    )  # fmt: skip
    return watch


@_run.register
def _(case: Push, rig: Rig) -> _Watch:
    source = (
        commands.playing_on(_clip(case.clip), rig.command_format, period_s=rig.period_s)
        if case.clip
        else commands.silence
    )
    towards = np.array([math.cos(case.towards_rad), math.sin(case.towards_rad), 0.0])
    return _drive(rig, source, case.seconds, push=case.speed_mps * towards, push_at_s=case.at_s)


@_run.register
def _(case: Arms, rig: Rig) -> _Watch:
    robot = _simulated(rig)
    speeds = dict(zip(robot.joint_names, robot.joint_speeds.tolist(), strict=True))
    return _drive(rig, commands.RandomArms(rig.command_format, speeds, case.seed), case.seconds, goes_on=True)


@_run.register
def _(case: Cut, rig: Rig) -> _Watch:
    source = commands.cut(
        _clip(case.clip), rig.command_format, case.silence,
        enter_s=min(case.at_s, ENTER_S), at_s=case.at_s, lead_s=rig.period_s,
    )  # fmt: skip
    return _drive(rig, source, case.seconds)


def _drive(
    rig: Rig,
    source: Commands,
    seconds: float,
    *,
    push: Floats | None = None,
    push_at_s: float = 0.0,
    goes_on: bool = False,
) -> _Watch:
    """Run from the start pose for so long, or to a fall, after which the rest may go on from the start pose.

    A push is a step in the velocity of the root, shape (3,) [m/s].
    """
    robot, watch = _simulated(rig), _Watch(rig)
    control = _fresh(rig, robot)
    for tick in range(round(seconds / rig.period_s)):
        now_s = tick * rig.period_s
        if push is not None and tick == round(push_at_s / rig.period_s):
            robot.push(push)
        record = _step(control, source(now_s), now_s)
        watch.see(record, counts=True)
        if record.fall is not None:
            if not goes_on:
                break
            control = _fresh(rig, robot)
    return watch


def _fresh(rig: Rig, robot: SimulatedRobot) -> ControlStep:
    rig.policy.reset()
    robot.reset()
    return rig.control()


def _step(control: ControlStep, command: Floats | None, now_s: float) -> StepRecord:
    """Do a step; without a command, the last one grows old. As in a rehearsal, it goes through its JSON text."""
    sample = None if command is None else samples_of(control.commanded.command_format, command, now_s)
    return control.step(control.sense(), sample, now_s)


def _late(rig: Rig, late_s: float) -> Rig:
    robot = _simulated(rig)
    return msgspec.structs.replace(rig, robot=LateRobot(robot, periods(late_s, rig.period_s)))


def _simulated(rig: Rig) -> SimulatedRobot:
    robot = rig.robot
    if not isinstance(robot, SimulatedRobot):
        raise ConfigError(
            f"robot {type(robot).__name__} cannot be put back on its feet and pushed; the suite needs a simulated one"
        )
    return robot


def _place(state: RobotState) -> Floats:
    if state.root_pos is None:
        raise ConfigError("the robot does not know where its root is; the suite needs that to measure drift")
    return np.array([*state.root_pos[:2], roll_pitch_yaw(state.quat_wxyz)[2]])


@lru_cache(maxsize=2)  # the policy, and the one it is held against
def _rig(config: bytes) -> Rig:
    return build(msgspec.json.decode(config, type=RigConfig))


@lru_cache(maxsize=8)
def _clip(reference: str) -> Motion:
    motion: Motion = registry.find("loader", "motion")(reference)
    return motion


def periods(late_s: float, period_s: float) -> int:
    """Return the fewest control periods that are at least so long [s]."""
    return math.ceil(late_s / period_s - _ROUNDING)


class LateRobot:
    """Implements `station.protocols.SimulatedRobot` around another.

    Args:
        robot: Moves when it hears.
        periods: How many control periods later; until then it follows the first targets.
    """

    def __init__(self, robot: SimulatedRobot, periods: int) -> None:
        self._robot, self._periods = robot, periods
        self._under_way: deque[JointTargets] = deque()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """As of the robot."""
        return self._robot.joint_names

    @property
    def joint_speeds(self) -> Floats:
        """As of the robot."""
        return self._robot.joint_speeds

    def read(self) -> RobotState:
        """Return the newest measurement; only targets are late."""
        return self._robot.read()

    def write(self, targets: JointTargets) -> JointTargets:
        """Send targets; return those that are applied now."""
        self._under_way.append(targets)
        has_come = len(self._under_way) > self._periods
        return self._robot.write(self._under_way.popleft() if has_come else self._under_way[0])

    def damp(self) -> None:
        """Damp the robot, at once."""
        self._robot.damp()

    def reset(self) -> None:
        """Put the robot back on its feet; nothing is under way to it."""
        self._under_way.clear()
        self._robot.reset()

    def push(self, velocity_step: Floats) -> None:
        """Push the robot, at once."""
        self._robot.push(velocity_step)

    def fallen(self) -> Fall | None:
        """Return why the robot counts as fallen."""
        return self._robot.fallen()

    def facts(self) -> dict[str, Any]:
        """Return what a manifest says of the robot."""
        return {**self._robot.facts(), "targets_late_periods": self._periods}

    def close(self) -> None:
        """Close the robot."""
        self._robot.close()
