"""Benchmark: walking by sticks with hands at work: how well velocities are met, whether it falls, what a tick costs."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from adapters.drivers.hands import HandsDriver
from adapters.retarget.walking import VelocityCommand, Walker
from adapters.robots.g1.joints import G1_29
from benchmarks.harness import Benchmark, Row, Settings, Target, compare, mean, p50, p99
from station import rotations
from station.bus import codec
from station.control.command_validator import CommandSample
from station.control.control import ControlStep, StepRecord
from station.control.rig import Rig, RigConfig, build
from station.operator.buttons import Buttons, button_map
from station.operator.driving import Driving
from station.operator.sample import OperatorSample, Pose
from station.protocols import Floats

STEP_S, TICK_S = 0.02, 0.01
ASKED = (
    (0.3, 0.0, 0.0), (0.5, 0.0, 0.0), (0.7, 0.0, 0.0), (-0.2, 0.0, 0.0), (-0.4, 0.0, 0.0), (0.0, 0.15, 0.0),
    (0.0, 0.3, 0.0), (0.0, -0.3, 0.0), (0.0, 0.0, 0.4), (0.0, 0.0, 0.8), (0.0, 0.0, -0.8), (0.5, 0.2, 0.4),
    (0.7, 0.0, 0.8), (-0.3, 0.0, 0.5), (0.0, 0.3, 0.6),
)  # fmt: skip
METHOD = """\
The built-in tracker on the built-in G1. *Speed*: velocities asked of the legs for ten seconds after they have settled,
against what the robot's pelvis really does in its own frame. *Sessions*: an operator who does not spare the robot:
sticks from end to end at any moment, both hands swinging, squats, the dead-man engaged and released every few seconds,
losses of signal. *Tick*: buttons, dead-man, both arms and the walk, in one thread; baseline: the 10 ms of a loop at
100 Hz."""

BUDGET_MS = 10.0
_SETTLED_S, _MEASURED_S = 4.0, 10.0


def run(settings: Settings) -> list[Row]:
    """Measure."""
    rig = build(RigConfig())
    asked = ASKED[:: 5 if settings.quick else 1]
    rows = []
    for velocity in asked:
        reached = velocity_reached(rig, velocity)
        told = " ".join(f"{value:+.2f}" for value in reached)
        x, y, yaw = velocity
        what = f"asked {x:+.2f} {y:+.2f} {yaw:+.2f}, went {told}: error of speed"
        rows.append(compare(what, "m/s", [[float(np.hypot(*(reached - velocity)[:2]))]], target=Target(limit=0.2)))
    sessions = [session(rig, seed, settings.pick(300.0, 10.0)) for seed in range(1 if settings.quick else 5)]
    costs = [found.costs_ms for found in sessions]
    budget = [[BUDGET_MS]] * len(costs)
    falls = [[float(sum(found.fell for found in sessions))]]
    first = [[max(found.first_difference for found in sessions)]]
    return [
        *rows,
        compare(f"falls in {len(sessions)} sessions", "falls", falls, by=mean, target=Target(limit=0.0)),
        compare("first command after engaging, difference", "rad or m", first, target=Target(limit=1e-6)),
        compare("a tick, p50", "ms", costs, budget, baseline="period at 100 Hz", by=p50, target=Target(limit=5.0)),
        compare("a tick, p99", "ms", costs, budget, baseline="period at 100 Hz", by=p99,
                target=Target(limit=1.0, of="ratio")),
    ]  # fmt: skip


def velocity_reached(rig: Rig, asked: tuple[float, float, float]) -> Floats:
    """Walk at a velocity; return the mean velocity of the robot in its own frame, not a number when it fell."""
    control, walker = fresh(rig), Walker()
    places = []
    for tick in range(round((_SETTLED_S + _MEASURED_S) / STEP_S)):
        reference = walker.step(STEP_S, VelocityCommand(*asked) if tick * STEP_S > 1.0 else VelocityCommand())
        record = follow(control, rig.command_format.encode(reference, G1_29), tick * STEP_S)
        if record.fall is not None:
            return np.full(3, np.nan)
        if tick * STEP_S > _SETTLED_S and record.state.root_pos is not None:
            yaw = float(rotations.roll_pitch_yaw(record.state.quat_wxyz)[2])
            places.append([*record.state.root_pos[:2], yaw])
    path = np.array(places)
    yaws = np.unwrap(path[:, 2])
    step, cosine, sine = np.diff(path[:, :2], axis=0), np.cos(yaws[:-1]), np.sin(yaws[:-1])
    forward, left = cosine * step[:, 0] + sine * step[:, 1], -sine * step[:, 0] + cosine * step[:, 1]
    return np.array([forward.mean(), left.mean(), np.diff(yaws).mean()]) / STEP_S


def fresh(rig: Rig) -> ControlStep:
    """A robot on its feet and a policy without history."""
    rig.policy.reset()
    rig.robot.reset()  # type: ignore[attr-defined]  # the rig is simulated
    return rig.control()


def follow(control: ControlStep, command: Floats, now_s: float) -> StepRecord:
    """Let the robot take a step at a command, as it stands on the bus."""
    command_format = control.commanded.command_format
    data = codec.json_vector(np.clip(command, command_format.lower, command_format.upper))
    return control.step(control.sense(), CommandSample(data, arrived_s=now_s), now_s)


@dataclass
class Operator:
    """An operator who moves at random, throws the sticks and presses the button now and then."""

    random: np.random.Generator
    hands_s: float = 0.0
    sticks: Floats = field(default_factory=lambda: np.zeros(4))
    next_sticks_s: float = 0.0
    next_press_s: float = 0.5
    silent_until_s: float = 0.0

    def at(self, now_s: float, *, is_engaged: bool) -> OperatorSample | None:
        """What the device sends at a time [s]; None for nothing."""
        if now_s > self.next_sticks_s:
            ends = np.sign(self.random.uniform(-1.0, 1.0, 4)) * self.random.uniform(0.2, 1.0, 4) * (1.0, 1.0, 1.0, 0.4)
            self.sticks = ends * self.random.integers(2)
            self.next_sticks_s = now_s + self.random.uniform(0.3, 4.0)
        if now_s > self.next_press_s + 0.1:
            self.next_press_s = now_s + self.random.uniform(*((3.0, 9.0) if is_engaged else (0.2, 1.5)))
        if self.random.random() < 5e-4:
            self.silent_until_s = now_s + 0.4
        self.hands_s += TICK_S * is_engaged  # who has let go keeps his hands where they are
        if now_s < self.silent_until_s:
            return None
        names = ("left_stick_y", "left_stick_x", "right_stick_x", "right_stick_y")
        controls = dict(zip(names, self.sticks.tolist(), strict=True))
        controls["right_primary"] = float(now_s > self.next_press_s)
        controls["right_stick_click"] = float(1.5 < now_s < 1.6)
        return OperatorSample(capture_ns=1, controls=controls, left=self._hand(1.0), right=self._hand(-1.0))

    def _hand(self, side: float) -> Pose:
        phase = 0.9 * self.hands_s + side * np.arange(6.0)
        swing = 0.5 * np.sin(phase) + 0.5 * np.sin(2.5 * phase + 1.0)
        raised = min(self.hands_s / 3.0, 1.0) * np.array([0.15, 0.0, 0.2])
        position = np.array([0.3, 0.2 * side, 1.2]) + raised + 0.18 * swing[:3]
        return Pose(position, rotations.from_rotation_vector(0.6 * swing[3:]))


@dataclass(frozen=True)
class Session:
    """How a session went; the difference is the greatest between a command of engaging and the one before it."""

    fell: bool
    first_difference: float
    costs_ms: list[float]


def session(rig: Rig, seed: int, seconds: float, on_step: Callable[[StepRecord], None] | None = None) -> Session:
    """Drive hands and legs for so long, or to a fall; `on_step` sees every step of the robot."""
    control = fresh(rig)
    driving = Driving(HandsDriver(), Buttons(button_map("pico")))
    operator = Operator(np.random.default_rng(seed))
    costs, difference, command = [], 0.0, driving.driver.command_format.default
    for tick in range(round(seconds / TICK_S)):
        now_s = tick * TICK_S
        reading = operator.at(now_s, is_engaged=driving.deadman.is_engaged)
        began_ns = time.perf_counter_ns()
        driven = driving.step(reading, TICK_S, why_blocked="" if reading else "stale")
        costs.append((time.perf_counter_ns() - began_ns) / 1e6)
        if driven.change is not None and driven.change.name == "operator-engaged":
            difference = max(difference, float(np.abs(driven.command - command).max()))
        command = driven.command
        if tick % 2 == 0:
            record = follow(control, command, now_s)
            if on_step is not None:
                on_step(record)
            if record.fall is not None:
                return Session(True, difference, costs)
    return Session(False, difference, costs)


BENCHMARK = Benchmark(name="walking", title="Walking by sticks, hands at work", method=METHOD, run=run)
