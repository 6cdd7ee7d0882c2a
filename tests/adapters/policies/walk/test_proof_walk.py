"""The built-in policies of velocities for hours: random velocities, pushes, arms that move, other bodies."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from random import Random
from typing import NamedTuple

import numpy as np
import pytest

from station.control.parted_path import samples_of
from station.control.rig import Rig, RigConfig, build
from station.control.tracking import VelocityTracking
from station.protocols import Floats
from tests.figures import Figures

SEEDS, MINUTES = 20, 10.0
ROBOTS = {"go2-walk": "go2-mujoco", "g1-walk": "g1-mujoco"}
ERROR = {"go2-walk": 0.10, "g1-walk": 0.15}
"""Mean |measured - commanded| of means over a second [m/s]: asked of the Go2; of the G1 what it does, and some."""


class Went(NamedTuple):
    """How a run ended: when it fell [s], or -1; the mean error of vx, vy [m/s], wz [rad/s]."""

    fell_s: float
    error: tuple[float, float, float]


def rig_of(policy: str, **options: float) -> Rig:
    return build(RigConfig(robot=ROBOTS[policy], policy=policy, robot_options={"physics_dt_s": 0.002, **options}))


def wander(policy: str, seed: int, minutes: float, armature: float = 0.0, latency_steps: int = 0) -> Went:
    """Follow velocities of up to 1 m/s and 1 rad/s, each for 2 to 6 s, begun at once."""
    rig, random = rig_of(policy, armature=armature, latency_steps=latency_steps), Random(seed)
    control, tracking = rig.control(), VelocityTracking(("vx", "vy", "wz"), rig.period_s)
    asked, until = np.zeros(3), 0
    lower, upper = rig.policy.spec.command_lower, rig.policy.spec.command_upper
    for tick in range(round(minutes * 60 / rig.period_s)):
        if tick >= until:
            asked, until = velocity(random, lower, upper), tick + round(random.uniform(2.0, 6.0) / rig.period_s)
        now_s = tick * rig.period_s
        record = control.step(control.sense(), samples_of(rig.command_format, asked, now_s), now_s)
        if record.fall is not None:
            return Went(now_s, (np.nan, np.nan, np.nan))
        place = rig.robot.qpos  # type: ignore[attr-defined]
        tracking.add(tick, now_s, record.decision.vector, place[:3], place[3:7])
    found = tracking.found()
    assert found is not None
    return Went(-1.0, found.error)


def velocity(random: Random, lower: Floats, upper: Floats) -> Floats:
    """Draw a velocity: a fifth stand, no more than 1 m/s in the plane."""
    if random.random() < 0.2:
        return np.zeros(3)
    drawn = np.array([random.uniform(*ends) for ends in zip(lower, upper, strict=True)])
    drawn[:2] /= max(1.0, float(np.hypot(*drawn[:2])))
    return drawn


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("policy", ROBOTS)
def test_ten_minutes_of_random_velocities_in_twenty_seeds_without_a_fall(policy: str, proof: Figures) -> None:
    """The first half on the model as it is, the second with the rotors of a light gear, where that is another body."""
    light = 0.01 if policy == "go2-walk" else 0.0
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        runs = [pool.submit(wander, policy, seed, MINUTES, 0.0 if seed < SEEDS / 2 else light) for seed in range(SEEDS)]
        went = [run.result() for run in runs]
    falls = [(seed, run.fell_s) for seed, run in enumerate(went) if run.fell_s >= 0.0]
    proof.figure(f"{policy}: falls in {SEEDS} x {MINUTES:g} min of random velocities", str(len(falls)), limit="0")
    assert not falls, falls
    vx, vy, wz = np.mean([run.error for run in went], axis=0)
    proof.figure(f"{policy}: mean error of vx, vy, wz", f"{vx:.3f}, {vy:.3f} m/s, {wz:.3f} rad/s",
                 limit=f"{ERROR[policy]:g} m/s")  # fmt: skip
    assert max(vx, vy) <= ERROR[policy]


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    ("policy", "latency_steps", "most"), [("go2-walk", 1, 0), ("g1-walk", 1, 0), ("g1-walk", 2, 2)]
)
def test_it_walks_with_motors_that_are_late(policy: str, latency_steps: int, most: int, proof: Figures) -> None:
    """A network that was trained on with targets 25 ms late at most fell once a second when they were 40 ms late."""
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        runs = [pool.submit(wander, policy, seed, MINUTES, latency_steps=latency_steps) for seed in range(4)]
        falls = [(seed, went.fell_s) for seed, run in enumerate(runs) if (went := run.result()).fell_s >= 0.0]
    what = f"{policy}: of 4 x {MINUTES:g} min of random velocities, targets {20 * latency_steps} ms late, with a fall"
    proof.figure(what, str(len(falls)), limit=str(most))
    assert len(falls) <= most, falls


@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("policy", "most_m_s"), [("go2-walk", 0.5), ("g1-walk", 0.4)])
def test_pushes_in_eight_directions_standing_and_walking(policy: str, most_m_s: float, proof: Figures) -> None:
    rig, falls, pushes = rig_of(policy), [], 0
    for asked in ((0.0, 0.0, 0.0), (0.5, 0.0, 0.0)):
        for direction in range(8):
            for moment in range(6):
                pushes += 1
                rig.policy.reset()
                rig.robot.reset()  # type: ignore[attr-defined]
                control, angle = rig.control(), direction * np.pi / 4
                there = round((2.0 + 0.13 * moment) / rig.period_s)
                for tick in range(there + round(4.0 / rig.period_s)):
                    if tick == there:
                        rig.robot.push(most_m_s * np.array([np.cos(angle), np.sin(angle), 0.0]))  # type: ignore[attr-defined]
                    now_s = tick * rig.period_s
                    record = control.step(control.sense(), samples_of(rig.command_format, asked, now_s), now_s)
                    if record.fall is not None:
                        falls.append((asked, direction, moment))
                        break
    proof.figure(f"{policy}: falls after {pushes} pushes of {most_m_s:g} m/s", str(len(falls)), limit="0")
    assert not falls, falls


def swing(reach_rad: float, seed: int, minutes: float) -> list[float]:
    """Follow velocities while all joints of the arms swing once a second, each in a phase of its own, under the policy
    that takes arms beside it; return when it fell [s]. It begins anew then."""
    rig = build(RigConfig(robot="g1-mujoco", policy="g1-arms", checkpoint="builtin:g1-walk.onnx",
                          policy_options={"legs": "g1-walk"}, robot_options={"physics_dt_s": 0.002}))  # fmt: skip
    phase, random = np.random.default_rng(seed).uniform(0, 2 * np.pi, 14), Random(seed)
    spec, until, asked = rig.policy.spec, 0, np.zeros(3)
    assert spec.command_lower is not None
    assert spec.command_upper is not None
    control, fell_s, since_s = rig.control(), list[float](), 0.0
    for tick in range(round(minutes * 60.0 / rig.period_s)):
        now_s = tick * rig.period_s
        if tick >= until:
            asked = velocity(random, spec.command_lower[:3], spec.command_upper[:3])
            until = tick + round(random.uniform(2.0, 6.0) / rig.period_s)
        swung = reach_rad * min(1.0, now_s - since_s) * np.sin(2 * np.pi * now_s + phase)
        command = np.concatenate([asked, rig.command_format.default[3:] + swung])
        record = control.step(control.sense(), samples_of(rig.command_format, command, now_s), now_s)
        if record.fall is not None:
            fell_s.append(round(now_s, 1))
            rig.policy.reset()
            rig.robot.reset()  # type: ignore[attr-defined]
            control, since_s = rig.control(), now_s
    return fell_s


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("reach_rad", [0.2, 0.5])
def test_a_g1_walks_and_stands_on_while_its_arms_swing(reach_rad: float, proof: Figures) -> None:
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        runs = [pool.submit(swing, reach_rad, seed, 10.0) for seed in range(4)]
        fell_s = {seed: run.result() for seed, run in enumerate(runs)}
    falls = sum(map(len, fell_s.values()))
    what = f"g1-walk: falls in 4 x 10 min of random velocities, arms swinging by {reach_rad:g} rad at 1 Hz"
    proof.figure(what, str(falls), limit="0")
    assert not falls, fell_s
