"""The whole evaluation: every case, on the policy and on the one that it is held against, side by side in processes."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from pathlib import PurePath

import msgspec
import numpy as np

from station import side_by_side
from station.contract import names_of
from station.control.rig import RigConfig, build
from station.control.tracking import VELOCITIES
from station.errors import UsageError
from station.suite import clips, promise
from station.suite.cases import Case, Cease, Group, HandOver, Walk
from station.suite.judge import Summary, judge
from station.suite.outcome import Outcome
from station.suite.promise import Extent
from station.suite.trial import run_case


class PolicyEvaluation(msgspec.Struct, frozen=True, kw_only=True):
    """One policy: how it is called in the table, what was run, and how it went by group and by case."""

    label: str
    rig: RigConfig
    groups: list[Summary]
    cases: list[Outcome]


class Evaluation(msgspec.Struct, frozen=True, kw_only=True):
    """What came of a suite.

    Attributes:
        extent: How much was run; its `arm_seeds` are all the chance there is in it.
        limits: What was asked, by group.
        missing: Clips that are not on this machine.
        policies: The policy that is judged, then perhaps the one that it is held against.
        wall_s: Time that it took [s], in `processes` processes.
    """

    extent: Extent
    limits: dict[Group, str]
    missing: list[str]
    policies: list[PolicyEvaluation]
    wall_s: float
    processes: int

    @property
    def is_of_velocities(self) -> bool:
        """Whether it is the suite of a policy that follows velocities."""
        return any(outcome.velocity is not None for outcome in self.policies[0].cases)

    @property
    def is_kept(self) -> bool:
        """Whether the policy keeps the promise in everything that was run."""
        return not any(summary.failures for summary in self.policies[0].groups)


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """What is to be run; see `Evaluation`."""

    extent: Extent
    cases: list[Case]
    missing: list[str]
    rigs: list[RigConfig]
    processes: int

    @property
    def runs(self) -> int:
        """How many runs that is."""
        return len(self.cases) * len(self.rigs)

    @property
    def walks(self) -> bool:
        """Whether any case follows a velocity that is drawn."""
        return any(isinstance(case, (Walk, Cease, HandOver)) for case in self.cases)

    def label(self, rig: int) -> str:
        """Return what the policy of a rig is called: its family, and its file where that is not enough."""
        config = self.rigs[rig]
        is_alone = [other.policy for other in self.rigs].count(config.policy) == 1
        return config.policy if is_alone else f"{config.policy} {PurePath(config.checkpoint).name}".strip()


def plan(
    rigs: Sequence[RigConfig],
    *,
    extent: Extent,
    named: Sequence[str] = (),
    only: Collection[Group] = (),
    jobs: int = 0,
    hand_over: tuple[str, str] = ("", ""),
) -> Plan:
    """List what there is to be run.

    Args:
        rigs: On what: the policy, and perhaps one that it is held against.
        extent: How much.
        named: Clips of the user's, in place of all that there are.
        only: Some of the groups; none for all.
        jobs: Processes; 0 for one per core, 1 for this process alone.
        hand_over: Family and file of the policy that takes turns with one that follows velocities; "" for itself.

    Raises:
        StationError: a clip or a policy cannot be read.
        UsageError: clips or another policy are named for policies that have no use for them.
    """
    missing: list[str] = []
    formats = [build(rig).control().commanded.command_format for rig in rigs]  # refuses what does not fit
    if all(set(VELOCITIES) <= set(names_of(each.elements)) for each in formats):
        if named:
            raise UsageError(f"{named[0]}: policy {rigs[0].policy!r} follows velocities; its suite plays no motions")
        places = [[names_of(each.elements).index(name) for name in VELOCITIES] for each in formats]
        both = list(zip(formats, places, strict=True))
        lower = np.max([each.lower[velocities] for each, velocities in both], axis=0)
        upper = np.min([each.upper[velocities] for each, velocities in both], axis=0)
        cases = promise.velocity_cases(extent, lower, upper, only, hand_over)
    else:
        if any(hand_over):
            raise UsageError(f"--hand-over: policy {rigs[0].policy!r} follows no velocities")
        found, missing = clips.find(named)
        cases = promise.cases(extent, found, only)
    if not cases:
        raise UsageError(f"the suite of policy {rigs[0].policy!r} has no group {', '.join(only)}")
    count = side_by_side.processes(len(cases) * len(rigs), jobs)
    return Plan(extent=extent, cases=cases, missing=missing, rigs=list(rigs), processes=count)


def run(planned: Plan, on_done: Callable[[str, Outcome], None] | None = None) -> Evaluation:
    """Run every case on every rig, the longest first.

    Args:
        planned: From `plan`.
        on_done: Called with the label of the rig and each outcome as it comes, in any order.

    Raises:
        StationError: something cannot be loaded; the first problem ends the rest.
    """
    started_s = time.perf_counter()
    cases, rigs = planned.cases, planned.rigs
    order = [(rig, number) for rig in range(len(rigs)) for number in range(len(cases))]
    order.sort(key=lambda task: -cases[task[1]].seconds)

    def on_result(result: tuple[int, Outcome]) -> None:
        if on_done is not None:
            on_done(planned.label(result[0]), result[1])

    tasks = [(rig, cases[number], rigs[rig]) for rig, number in order]
    done = side_by_side.run(_work, tasks, jobs=planned.processes, on_done=on_result)
    found = {task: outcome for task, (_, outcome) in zip(order, done, strict=True)}
    outcomes = [[found[rig, number] for number in range(len(cases))] for rig in range(len(rigs))]
    policies = [
        PolicyEvaluation(
            label=planned.label(rig), rig=rigs[rig], cases=mine,
            groups=judge(mine, against=outcomes[1] if len(rigs) > 1 and rig == 0 else ()),
        )
        for rig, mine in enumerate(outcomes)
    ]  # fmt: skip
    return Evaluation(
        extent=planned.extent, limits=promise.LIMITS, missing=planned.missing, policies=policies,
        wall_s=time.perf_counter() - started_s, processes=planned.processes,
    )  # fmt: skip


def _work(task: tuple[int, Case, RigConfig]) -> tuple[int, Outcome]:
    rig, case, config = task
    with clips.quietly():
        return rig, run_case(case, config)
