"""Benchmark: what a frame of whole-body retargeting costs, and how the tracker follows what comes of it."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from adapters.motions import builtin
from adapters.motions.load import load
from adapters.retarget.calibration import of_person
from adapters.retarget.human import of_height
from adapters.retarget.pipeline import BodyRetarget
from adapters.retarget.played import RetargetedMotion, noisy, person_of
from benchmarks.harness import Benchmark, Row, Settings, Target, compare, mean, p50, p99
from station.control.rig import Rig, RigConfig, build
from station.protocols import Motion
from station.rehearse import Rehearsal, rehearse

METHOD = """\
A person of 1.7 m does built-in clips and is tracked at 90 Hz with white noise of 1 mm and 0.3°. *Frame*: a body in,
a reference out, all layers, in one thread. Baseline: the 10 ms that a loop at 100 Hz has. *Following*: the built-in
tracker on the built-in G1, physics at 2 ms, every clip; baseline: the clip itself, followed by the same tracker."""

BUDGET_MS = 10.0
_HEIGHT_M = 1.7
_METRES, _RADIANS = 0.001, 0.005


def run(settings: Settings) -> list[Row]:
    """Measure."""
    names = [name for name in builtin.names() if name != "tour"]
    clips = [f"{builtin.clips.PREFIX}{name}" for name in (names[:2] if settings.quick else names)]
    frames = [_frames(load("builtin:walk-arc")) for _ in range(settings.rounds)]
    budget = [[BUDGET_MS] * len(taken) for taken in frames]
    first = [[_first_ms()] for _ in range(settings.rounds)]
    rig = build(RigConfig(robot_options={"physics_dt_s": 0.002}))
    logging.disable(logging.WARNING)
    try:
        ours, theirs = [], []
        for clip in clips:
            motion = load(clip)
            theirs.append(_followed(motion, rig))
            ours.append(_followed(_retargeted(motion), rig))
    finally:
        logging.disable(logging.NOTSET)
        rig.robot.close()
    return [
        *_costs(frames, budget, first),
        compare("falls in following the person, all clips", "falls", [[_falls(ours)]], [[_falls(theirs)]],
                baseline="clip itself", by=mean, target=Target(limit=float(_falls(theirs)))),
        compare("mean joint error in following the person", "mrad", [_errors_mrad(ours)], [_errors_mrad(theirs)],
                baseline="clip itself", by=mean, target=Target(limit=1.2, of="ratio")),
    ]  # fmt: skip


def _costs(frames: list[list[float]], budget: list[list[float]], first: list[list[float]]) -> list[Row]:
    baseline = "period at 100 Hz"
    return [
        compare("one frame, all layers, p50", "ms", frames, budget, baseline=baseline, by=p50,
                target=Target(limit=5.0)),
        compare("one frame, all layers, p99", "ms", frames, budget, baseline=baseline, by=p99,
                target=Target(limit=1.0, of="ratio")),
        compare("first frame after a reset", "ms", first, by=p50),
    ]  # fmt: skip


def _frames(motion: Motion) -> list[float]:
    person = noisy(person_of(motion, _HEIGHT_M), metres=_METRES, radians=_RADIANS)
    retarget = BodyRetarget(of_person(of_height(_HEIGHT_M)))
    step = _timed(retarget.step)
    return [step(person.body(index), person.capture_ns(index)) for index in range(len(person))][1:]


def _first_ms() -> float:
    person = person_of(load("builtin:squat"), _HEIGHT_M)
    retarget = BodyRetarget(of_person(of_height(_HEIGHT_M)))
    return _timed(retarget.step)(person.body(len(person) // 2), 1)


def _timed(step: Callable[..., object]) -> Callable[..., float]:
    def timed(*arguments: object) -> float:
        began_ns = time.perf_counter_ns()
        step(*arguments)
        return (time.perf_counter_ns() - began_ns) / 1e6

    return timed


def _retargeted(motion: Motion) -> RetargetedMotion:
    person = noisy(person_of(motion, _HEIGHT_M), metres=_METRES, radians=_RADIANS)
    return RetargetedMotion(person, calibration=of_person(of_height(_HEIGHT_M)), name=motion.name)


def _followed(motion: Motion, rig: Rig) -> Rehearsal:
    return rehearse(motion, rig.policy, rig.robot, rig.command_format, period_s=rig.period_s)


def _falls(rehearsals: list[Rehearsal]) -> int:
    return sum(rehearsal.fell for rehearsal in rehearsals)


def _errors_mrad(rehearsals: list[Rehearsal]) -> list[float]:
    return [1e3 * rehearsal.mean_joint_error_rad for rehearsal in rehearsals if rehearsal.mean_joint_error_rad]


BENCHMARK = Benchmark(name="retarget", title="Retargeting", method=METHOD, run=run)
