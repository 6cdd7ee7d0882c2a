"""Benchmark: what one step of our own policy costs, beside its teacher's."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from benchmarks.harness import Benchmark, Row, Settings, Target, alternate, compare, p50, p99
from station import assets, registry
from station.control.rig import checkpoint_of
from station.protocols import Policy, RobotState

METHOD = """\
Observation, inference and targets of one control step, on one core and one thread, on random states and commands; the
two policies take turns. Baseline: TWIST2's network through the same adapter code."""

_STEPS = 2000


def run(settings: Settings) -> list[Row]:
    """Measure."""
    steps = int(settings.pick(_STEPS, 100))
    contenders = {name: _turn(name, steps) for name in ("tracker", "twist2")}
    taken = alternate(contenders, settings.rounds)
    ours, theirs = taken["tracker"], taken["twist2"]
    return [
        compare("one step of the policy `tracker`, p50", "us", ours, theirs, by=p50, baseline="twist2",
                target=Target(limit=150.0)),
        compare("one step of the policy `tracker`, p99", "us", ours, theirs, by=p99, baseline="twist2"),
    ]  # fmt: skip


def _turn(name: str, steps: int) -> Callable[[], list[float]]:
    policy: Policy = registry.find("policy", name)(assets.resolve(checkpoint_of(name)))
    random = np.random.default_rng(0)
    spec = policy.spec
    state = RobotState(
        mono_ns=0,
        q=spec.default_q + random.normal(size=len(spec.joint_names)) * 0.1,
        dq=random.normal(size=len(spec.joint_names)),
        quat_wxyz=np.array([1.0, 0.0, 0.0, 0.0]),
        gyro=random.normal(size=3),
    )
    command = np.array(registry.find("command", spec.command).default)

    def act() -> list[float]:
        taken_us = []
        for _ in range(steps):
            began_ns = time.perf_counter_ns()
            policy.targets(policy.act(policy.observe(state, command)), command)
            taken_us.append((time.perf_counter_ns() - began_ns) / 1e3)
        return taken_us

    return act


BENCHMARK = Benchmark(name="inference", title="Policy", method=METHOD, run=run, needs_assets=True)
