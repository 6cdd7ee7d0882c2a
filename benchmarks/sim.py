"""Benchmark: how fast the simulation runs when nothing holds it back."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import numpy as np

from benchmarks import processes, stock, upstream
from benchmarks.harness import Benchmark, Row, Settings, Target, alternate, compare
from station import assets, registry
from station.bus import codec
from station.control.command_validator import CommandSample
from station.control.control import Resettable
from station.control.rig import build
from station.motion.playback import Playback
from station.protocols import Motion
from station.rehearse import rehearse

_TORQUE_LIMIT_NM = [88.0, 139.0, 88.0, 139.0, 50.0, 50.0] * 2 + [88.0, 50.0, 50.0] + [25.0] * 14
_PERIOD_S = 0.02

METHOD = """\
One TWIST2 motion through playback, command text, gate, TWIST2's policy and the meshed G1, free-running, loading left
out: the `rehearse` of the command line, one process. Baseline: stock's loop as it steps 1 ms of physics at a time with
PD in numpy before each, and its network with the runtime's default threads, on commands made beforehand; its pacing
sleep, viewer and bus are left out, to its advantage. *Control loop*: ours on the same commands made beforehand, with
parsing, gate and the watch for falls, which the baseline does not have."""


def run(settings: Settings) -> list[Row]:
    """Measure."""
    baseline = "stock loop, 1 ms"
    with contextlib.ExitStack() as stack:
        start = stack.enter_context
        contenders = {
            "control": start(processes.Worker(ours_on_ready_commands)),
            "1 ms": start(processes.Worker(ours, 0.001)),
            "2 ms": start(processes.Worker(ours, 0.002)),
            baseline: start(processes.Worker(theirs)),
        }
        taken = alternate({name: _turn(worker) for name, worker in contenders.items()}, settings.rounds)
    at_1_ms, at_2_ms = taken["1 ms"], taken["2 ms"]
    return [
        compare("closed loop, physics at 1 ms", "x real time", at_1_ms, taken[baseline], baseline=baseline,
                target=Target(limit=6.0, sense=">=")),
        compare("control loop alone, physics at 1 ms", "x real time", taken["control"], taken[baseline],
                baseline=baseline),
        compare("closed loop, physics at 2 ms", "x real time", at_2_ms, taken[baseline], baseline=baseline,
                target=Target(limit=6.0, sense=">=")),
    ]  # fmt: skip


@contextlib.contextmanager
def ours(physics_dt_s: float) -> Iterator[Callable[[], float]]:
    """Load our rig in this process; yields what rehearses and returns the speed."""
    rig = build(
        msgspec.structs.replace(upstream.RIG, robot_options=upstream.RIG.robot_options | {"physics_dt_s": physics_dt_s})
    )
    motion = stock_motion()

    def act() -> float:
        result = rehearse(motion, rig.policy, rig.robot, rig.command_format, period_s=rig.period_s)
        return result.speed_x_realtime

    yield act
    rig.robot.close()


@contextlib.contextmanager
def ours_on_ready_commands() -> Iterator[Callable[[], float]]:
    """Load our rig in this process; yields what runs control alone on the motion's commands and returns the speed."""
    rig = build(upstream.RIG)
    robot = rig.robot
    assert isinstance(robot, Resettable)
    samples = [codec.json_vector(command) for command in motion_commands(stock_motion())]

    def act() -> float:
        rig.policy.reset()
        robot.reset()
        control = rig.control()
        began_s = time.perf_counter()
        for tick, data in enumerate(samples):
            now_s = tick * _PERIOD_S
            control.step(control.sense(), CommandSample(data, arrived_s=now_s), now_s)
        return len(samples) * _PERIOD_S / (time.perf_counter() - began_s)

    yield act
    rig.robot.close()


@contextlib.contextmanager
def theirs() -> Iterator[Callable[[], float]]:
    """Load stock's loop in this process; yields what runs it on the same commands and returns the speed."""
    constants, commands = stock_constants(), motion_commands(stock_motion())

    def act() -> float:
        return stock.Simulation(*constants).run(commands)

    yield act


def stock_constants() -> tuple[Any, ...]:
    """Return what a `stock.Simulation` is made of, so that it does what our rig does."""
    spec = registry.find("policy", "twist2")(assets.resolve(upstream.CHECKPOINT)).spec
    model = assets.resolve(upstream.ROBOT_MODEL)
    return model, spec.checkpoint, spec.default_q, spec.kp, spec.kd, np.array(_TORQUE_LIMIT_NM)


def stock_motion() -> Motion:
    """Return the motion that stock's programs play, as ours do."""
    logging.getLogger("adapters").setLevel(logging.ERROR)  # what was trimmed is for the users of a motion
    motion: Motion = registry.find("loader", "motion")(upstream.MOTION)
    return motion


def motion_commands(motion: Motion) -> list[np.ndarray]:
    """Return the command of each period of a motion, shape (35,)."""
    command_format = registry.find("command", "twist2")
    playback, found = Playback(motion, command_format), []
    while not playback.is_done:
        found.append(np.array(playback.step(_PERIOD_S).command))
    return found


def _turn(worker: processes.Worker) -> Callable[[], list[float]]:
    return lambda: [worker.ask()]


BENCHMARK = Benchmark(name="sim", title="Simulation speed", method=METHOD, run=run, needs_assets=True)
