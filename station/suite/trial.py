"""One case on one rig."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from functools import lru_cache, singledispatch
from typing import Any

import msgspec
import numpy as np

from station import registry
from station.contract import names_of
from station.control.control import ControlStep, StepRecord
from station.control.parted_path import samples_of
from station.control.policy_switch import PolicySwitch
from station.control.rig import PolicyChoice, Rig, RigConfig, build
from station.control.tracking import VELOCITIES, TrackingError, VelocityTracking
from station.errors import ConfigError
from station.protocols import Fall, Floats, JointTargets, Motion, RobotState, SimulatedRobot
from station.rehearse import rehearse
from station.rotations import roll_pitch_yaw, tilt
from station.suite import attacks, commands
from station.suite.cases import STILL, Arms, Attacked, Case, Cease, Cut, HandOver, Push, Stand, Track, Velocity, Walk
from station.suite.commands import Commands
from station.suite.outcome import Ceased, Drift, FallOutcome, Outcome, Trace, TurnsTaken
from station.suite.promise import (
    ATTACKED_S,
    CEASES_S,
    COMES_BACK_S,
    ENTER_S,
    SETTLED_S,
    STARTS_S,
    TURN_EVERY_S,
    WALKED_S,
)

_ROUNDING = 1e-9
_TRACE_S = 0.1  # a picture shows no more
_OTHER = "the other"

BeforeStep = Callable[[ControlStep, int], None]
"""Called before a step, with its number, from 0."""


def run_case(case: Case, config: RigConfig) -> Outcome:
    """Run a case to its end, or to a fall; what a rig and a clip are made of is loaded once per process.

    Raises:
        ConfigError: the robot is not simulated, or the policy's commands have no arms.
        StationError: something cannot be loaded.
    """
    started_s = time.perf_counter()
    # What hands over begins with its first policy only when it is new.
    rig = build(_taking_turns(config, case)) if isinstance(case, HandOver) else _rig(msgspec.json.encode(config))
    watch = _run(case, rig)
    asked = case.velocity if isinstance(case, (Walk, Cease, HandOver, Push)) else STILL
    return Outcome(
        case=case.name,
        group=case.group,
        falls=tuple(watch.falls),
        joint_error_rad=watch.error.mean_joint_error_rad,
        lean_rad=watch.lean_rad,
        drift=watch.drift(case),
        simulated_s=watch.ticks * rig.period_s,
        wall_s=time.perf_counter() - started_s,
        target_step=max(watch.target_step.values()),
        asked=asked,
        velocity=watch.velocity.found(),
        trace=watch.trace() if isinstance(case, (Walk, Cease, HandOver)) else None,
        ceased=watch.ceased(case.velocity) if isinstance(case, Cease) and not watch.falls else None,
        turns=watch.turns() if isinstance(case, HandOver) else None,
    )


class _Watch:
    """Sees every step of a run."""

    def __init__(self, rig: Rig) -> None:
        self.ticks = 0
        self.falls: list[FallOutcome] = []
        self.lean_rad = 0.0
        names = names_of(rig.command_format.elements)
        self.error = TrackingError(names, rig.robot.joint_names)
        self.velocity = VelocityTracking(names, rig.period_s)
        self._velocities = [names.index(name) for name in VELOCITIES if name in names]
        self.target_step = {False: 0.0, True: 0.0}  # by whether a policy was handing over
        self._period_s = rig.period_s
        self._places: list[Floats] = []  # x, y [m] and yaw [rad] of the root
        self._commands: list[Floats] = []  # velocities
        self._farthest = _simulated(rig).joint_speeds * rig.period_s
        self._sent: Floats | None = None
        self._switch = rig.policy if isinstance(rig.policy, PolicySwitch) else None
        self._was_switching = False
        self._drivers: list[str] = []  # each time that another one drives

    def see(self, record: StepRecord, *, counts: bool) -> None:
        """Add a step; `counts` tells whether its joint error does."""
        state, fall, gate = record.state, record.fall, record.decision.state
        if counts and gate == "tracking":
            self.error.add(state.q, record.decision.vector)
        place = _place(state)
        if gate == "tracking" and state.root_pos is not None:
            at_s = self.ticks * self._period_s
            self.velocity.add(self.ticks, at_s, record.decision.vector, state.root_pos, state.quat_wxyz)
        self._places.append(place)
        self._commands.append(record.decision.vector[self._velocities])
        self._see_targets(record)
        self.lean_rad = max(self.lean_rad, float(tilt(state.quat_wxyz)))
        self.ticks += 1
        if fall is not None:
            self.lean_rad = max(self.lean_rad, fall.tilt_rad)
            at_s = self.ticks * self._period_s
            self.falls.append(FallOutcome(at_s=at_s, lean_rad=fall.tilt_rad, contacts=fall.contacts, gate=gate))

    def _see_targets(self, record: StepRecord) -> None:
        is_switching = self._switch is not None and self._switch.is_switching
        if self._sent is not None:
            step = float((np.abs(record.sent.q - self._sent) / self._farthest).max())
            part = is_switching or self._was_switching
            self.target_step[part] = max(self.target_step[part], step)
        # After a fall the robot is put elsewhere.
        self._sent, self._was_switching = None if record.fall is not None else record.sent.q, is_switching
        if self._drivers[-1:] != [record.policy]:
            self._drivers.append(record.policy)

    def drift(self, case: Case) -> Drift | None:
        """Return how far it went while it was to stand; None where it was not, or fell."""
        if self.falls or not isinstance(case, (Stand, Cease)):
            return None
        if isinstance(case, Stand):
            settled, end = min(round(SETTLED_S / self._period_s), len(self._places) // 2), len(self._places)
        else:  # it has stopped in the middle of the silence
            settled, end = (round(at_s / self._period_s) for at_s in ((CEASES_S + COMES_BACK_S) / 2, COMES_BACK_S))
        places = np.array(self._places[settled:end])
        away_m = np.hypot(*(places[:, :2] - places[0, :2]).T)
        yaw = np.unwrap(places[:, 2])
        return Drift(end_m=float(away_m[-1]), greatest_m=float(away_m.max()), yaw_rad=float(yaw[-1] - yaw[0]))

    def trace(self) -> Trace:
        every = max(1, round(_TRACE_S / self._period_s))
        rows = self.velocity.curves()
        rows = rows[(np.arange(len(rows)) % every == 0) | np.isnan(rows[:, 0])]  # gaps stay
        places = np.array(self._places[::every])[:, :2]
        return Trace(
            times_s=rows[:, 0].round(3).tolist(), commanded=rows[:, 1:4].round(4).tolist(),
            measured=rows[:, 4:].round(4).tolist(), path=(places - places[0]).round(4).tolist(),
        )  # fmt: skip

    def ceased(self, velocity: Velocity) -> Ceased:
        last, back = (round(at_s / self._period_s) for at_s in (CEASES_S, COMES_BACK_S))
        commands = np.array(self._commands[last - 1 : back])
        moves = np.flatnonzero(commands.any(axis=1))
        zero_after_s = (moves[-1] + 1) * self._period_s if moves[-1] + 1 < len(commands) else math.inf
        steps = np.abs(np.diff(commands, axis=0)).max() / np.abs(velocity).max()
        return Ceased(zero_after_s=float(zero_after_s), greatest_step=float(steps))

    def turns(self) -> TurnsTaken:
        return TurnsTaken(
            count=len(self._drivers) - 1,
            refusal=self._switch.refusal if self._switch is not None else "",
            target_step=self.target_step[True],
            target_step_else=self.target_step[False],
        )


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
        envelopes=rig.envelopes, on_step=lambda frame, record: watch.see(record, counts=frame.phase == "playing"),
    )  # fmt: skip
    return watch


@_run.register
def _(case: Push, rig: Rig) -> _Watch:
    source: Commands = commands.silence
    if case.clip:
        source = commands.playing_on(_clip(case.clip), rig.command_format, period_s=rig.period_s)
    elif case.velocity != STILL:
        source = commands.velocity(rig.command_format, case.velocity, from_s=0.0, until_s=math.inf)
    towards = np.array([math.cos(case.towards_rad), math.sin(case.towards_rad), 0.0])

    def push(_: ControlStep, tick: int) -> None:
        if tick == round(case.at_s / rig.period_s):
            _simulated(rig).push(case.speed_mps * towards)

    return _drive(rig, source, case.seconds, before_step=push)


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


@_run.register
def _(case: Walk, rig: Rig) -> _Watch:
    source = commands.velocity(rig.command_format, case.velocity, from_s=STARTS_S, until_s=STARTS_S + WALKED_S)
    return _drive(_late(rig, case.late_s), source, case.seconds)


@_run.register
def _(case: Cease, rig: Rig) -> _Watch:
    source = commands.velocity(
        rig.command_format, case.velocity, from_s=STARTS_S, until_s=case.seconds, quiet=(CEASES_S, COMES_BACK_S)
    )
    return _drive(rig, source, case.seconds)


@_run.register
def _(case: HandOver, rig: Rig) -> _Watch:
    source = commands.velocity(rig.command_format, case.velocity, from_s=STARTS_S, until_s=case.seconds)

    def take_turns(control: ControlStep, tick: int) -> None:
        policies = control.policies
        if policies is not None and tick and tick % round(TURN_EVERY_S / rig.period_s) == 0:
            first, other = policies.names
            policies.switch(other if policies.driving == first else first)

    return _drive(rig, source, case.seconds, before_step=take_turns)


@_run.register
def _(case: Attacked, rig: Rig) -> _Watch:
    motions = [_clip(clip) for clip in case.clips]
    stream, writers = attacks.commands(
        case.attack, case.seed, rig.command_format, rig.envelopes, motions, seconds=ATTACKED_S, period_s=rig.period_s
    )
    last = len(stream) - 1

    def command(now_s: float) -> Floats:
        found: Floats = stream[min(round(now_s / rig.period_s), last)]
        return found

    def writer(now_s: float) -> str:
        return writers[min(round(now_s / rig.period_s), last)]

    return _drive(rig, command, case.seconds, writer=writer)


def _taking_turns(config: RigConfig, case: HandOver) -> RigConfig:
    """Return a rig with the other policy beside its own."""
    other = PolicyChoice(policy=case.policy, checkpoint=case.checkpoint)
    if not case.policy:
        (own,) = config.choices.values()
        other = msgspec.structs.replace(own, checkpoint=case.checkpoint or own.checkpoint)
    return msgspec.structs.replace(config, policies={_OTHER: other})


def _drive(
    rig: Rig,
    source: Commands,
    seconds: float,
    *,
    before_step: BeforeStep | None = None,
    goes_on: bool = False,
    writer: Callable[[float], str] = lambda _: "",
) -> _Watch:
    """Run from the start pose for so long, or to a fall, after which the rest may go on from the start pose."""
    robot, watch = _simulated(rig), _Watch(rig)
    control = _fresh(rig, robot)
    for tick in range(round(seconds / rig.period_s)):
        now_s = tick * rig.period_s
        if before_step is not None:
            before_step(control, tick)
        record = _step(control, source(now_s), now_s, writer(now_s))
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


def _step(control: ControlStep, command: Floats | None, now_s: float, writer: str) -> StepRecord:
    """Do a step; without a command, the last one grows old. As in a rehearsal, it goes through its JSON text."""
    sample = None if command is None else samples_of(control.commanded.command_format, command, now_s, writer)
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


@lru_cache(maxsize=64)  # attacks take from all
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
