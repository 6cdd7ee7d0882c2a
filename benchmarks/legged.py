"""Benchmark: what a control step of each policy costs, of one and of several at once, and how fast each robot runs."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from benchmarks import processes
from benchmarks.harness import Benchmark, Row, Settings, alternate, compare, p50, p99
from benchmarks.sim import motion_commands
from benchmarks.walking import fresh
from station import assets, registry
from station.contract import names_of
from station.control.control import Resettable
from station.control.parted_path import samples_of
from station.control.policy_switch import PolicySwitch
from station.control.rig import PolicyChoice, Rig, RigConfig, build
from station.control.tracking import VELOCITIES
from station.errors import StationError
from station.protocols import CommandFormat, Floats

METHOD = """\
Each robot in its mesh-free model walks at 0.5 m/s, free-running, in a process of its own; who follows motions does
`builtin:walk-forward`. *Step*: from the command's text to targets that are sent, gate, envelope, observation, inference
and limits included, physics not; baseline: the tracker's without an envelope. *Hands over*: two policies take turns
twice a second and are blended in half of the time. *Speed*: of the whole loop, physics included; baseline: the same
robot, read and sent one set of targets again and again, and put on its feet every second. A policy whose file is not on
the machine is left out."""

_TICKS, _AHEAD_MPS, _AGAIN_S = 1000, 0.5, 1.0
_TURN_S, _BLEND_S = 0.5, 0.25
_BASELINE = "tracker, no envelope"
_WALKS_AND_TRACKS = RigConfig(
    robot="g1-mujoco", policy="g1-walks", policies={"tracks": PolicyChoice(policy="g1-tracks")}, blend_s=_BLEND_S
)


def _zoo(robot: str, policy: str, file: str) -> RigConfig:
    return RigConfig(robot=f"{robot}-mujoco", policy=policy, checkpoint=f"zoo:policies/{file}")


CONTENDERS = {
    _BASELINE: RigConfig(robot="g1-mujoco", policy="tracker", envelope="none"),
    "tracker": RigConfig(robot="g1-mujoco", policy="tracker"),
    "g1-walk": RigConfig(robot="g1-mujoco", policy="g1-walk"),
    "g1-walks, g1-tracks ready": _WALKS_AND_TRACKS,
    "g1-walks hands over to g1-tracks": _WALKS_AND_TRACKS,
    "legs by rlgym-g1, arms by joints": RigConfig(
        robot="g1-mujoco", policy="g1-arms", policy_options={"legs": "rlgym-g1"},
        checkpoint="zoo:policies/rlgym_g1_motion.pt",
    ),
    "holosoma": _zoo("g1", "holosoma", "holosoma_fastsac_g1_29dof.onnx"),
    "falcon": _zoo("g1", "falcon", "falcon_g1_29dof.onnx"),
    "playground-g1": _zoo("g1", "playground-g1", "playground_g1_policy.onnx"),
    "rlgym-g1": _zoo("g1-12", "rlgym-g1", "rlgym_g1_motion.pt"),
    "rlgym-h1": _zoo("h1-10", "rlgym-h1", "rlgym_h1_motion.pt"),
    "rlgym-h1-2": _zoo("h1-2-12", "rlgym-h1-2", "rlgym_h1_2_motion.pt"),
    "playground-go1": _zoo("go1", "playground-go1", "playground_go1_policy.onnx"),
    "go2-walk": RigConfig(robot="go2-mujoco", policy="go2-walk"),
    "pilla-go2": _zoo("go2", "pilla-go2", "pilla_go2_policy.jit"),
}  # fmt: skip


class Turn(NamedTuple):
    """Cost of each step [us], speed of the loop and of the robot alone [x real time]."""

    steps_us: list[float]
    speed: float
    alone: float


def run(settings: Settings) -> list[Row]:
    """Measure."""
    ticks = int(settings.pick(_TICKS, 50))
    with contextlib.ExitStack() as stack:
        workers = {
            name: stack.enter_context(processes.Worker(_walks, config, "hands over" in name, ticks))
            for name, config in CONTENDERS.items()
            if _is_here(config)
        }
        taken = alternate({name: worker.ask for name, worker in workers.items()}, settings.rounds)
    baseline: list[Turn] = taken[_BASELINE]
    theirs = [turn.steps_us for turn in baseline]
    steps = [
        compare(f"step of {name}, {told}", "us", [turn.steps_us for turn in turns], theirs, by=by, baseline=_BASELINE)
        for name, turns in taken.items()
        if name != _BASELINE
        for told, by in (("p50", p50), ("p99", p99))
    ]
    speeds = [
        compare(f"speed of {CONTENDERS[name].kind.name} by {name}", "x real time", [[turn.speed] for turn in turns],
                [[turn.alone] for turn in turns], baseline="the robot alone")
        for name, turns in taken.items()
    ]  # fmt: skip
    return [*steps, *speeds]


@contextlib.contextmanager
def _walks(config: RigConfig, takes_turns: bool, ticks: int) -> Iterator[Callable[[], Turn]]:
    """Load a rig in this process; yields what has it walk for some ticks."""
    rig = build(config)
    commands = _commands(rig.command_format, ticks)

    def act() -> Turn:
        steps_us, loop_s = _walk(rig, commands, takes_turns)
        simulated_s = ticks * rig.period_s
        return Turn(steps_us, simulated_s / loop_s, simulated_s / _stand(rig, commands[0], ticks))

    yield act
    rig.robot.close()


def _walk(rig: Rig, commands: list[Floats], takes_turns: bool) -> tuple[list[float], float]:
    """Return what each step cost [us], and how long the loop took [s]."""
    control, switch = fresh(rig), rig.policy if isinstance(rig.policy, PolicySwitch) else None
    samples = [samples_of(rig.command_format, command, tick * rig.period_s) for tick, command in enumerate(commands)]
    turn, steps_us = round(_TURN_S / rig.period_s), []
    began_s = time.perf_counter()
    for tick, sample in enumerate(samples):
        if takes_turns and switch is not None and tick and tick % turn == 0:
            switch.switch(next(name for name in switch.names if name != switch.driving))
        state = control.sense()
        began_ns = time.monotonic_ns()
        record = control.step(state, sample, tick * rig.period_s)
        steps_us.append((record.timing_ns[-1] - began_ns) / 1e3)
    return steps_us, time.perf_counter() - began_s


def _stand(rig: Rig, command: Floats, ticks: int) -> float:
    """Return how long the robot alone takes for some ticks [s]."""
    fresh(rig)
    robot, again = rig.robot, round(_AGAIN_S / rig.period_s)
    assert isinstance(robot, Resettable)
    targets = rig.policy.targets(rig.policy.act(rig.policy.observe(robot.read(), command)), command)
    began_s = time.perf_counter()
    for tick in range(ticks):
        if tick % again == 0:
            robot.reset()
        robot.read()
        robot.write(targets)
    return time.perf_counter() - began_s


def _commands(command_format: CommandFormat, ticks: int) -> list[Floats]:
    names = names_of(command_format.elements)
    if set(VELOCITIES) <= set(names):
        command = np.array(command_format.default)
        command[names.index("vx")] = _AHEAD_MPS
        return [command] * ticks
    found = motion_commands(registry.find("loader", "motion")("builtin:walk-forward"))
    return [found[min(tick, len(found) - 1)] for tick in range(ticks)]


def _is_here(config: RigConfig) -> bool:
    try:
        return not config.checkpoint or bool(assets.resolve(config.checkpoint))
    except StationError:
        return False


BENCHMARK = Benchmark(name="legged", title="Robots on legs", method=METHOD, run=run)
