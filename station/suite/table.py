"""The table of a suite: cells for a terminal, a text file or a model card."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

from station.suite.judge import Summary
from station.suite.outcome import Outcome
from station.suite.promise import LIMITS
from station.suite.run import PolicyEvaluation

TITLES = (
    "group", "policy", "runs", "falls", "error [rad]", "worst", "lean [°]", "drift [m]", "most", "yaw [rad]",
    "verdict", "time [s]", "worst case",
)  # fmt: skip
"""Errors are means over the cases and of the worst case; a drift is that in the end and at most."""

CASE_TITLES = (
    "group", "policy", "case, commanded", "measured vx vy wz", "error", "falls", "drift [m]", "jump", "verdict",
)  # fmt: skip
"""Of a table with a row per case: velocities [m/s, m/s, rad/s]; a jump is the greatest step of a target from tick to
tick, as a share of how far its joint can move in it; where policies hand over, that meanwhile."""

LEFT = {"group", "policy", "verdict", "worst case", "case, commanded"}
_NOTHING = "–"


def rows(policies: Sequence[PolicyEvaluation]) -> list[tuple[str, ...]]:
    """Return a row per group and policy, the policies of a group below each other; only the first one is judged."""
    found = []
    for group in LIMITS:
        for place, policy in enumerate(policies):
            found += [_row(policy.label, row, is_judged=place == 0) for row in policy.groups if row.group == group]
    return found


def case_rows(policies: Sequence[PolicyEvaluation]) -> list[tuple[str, ...]]:
    """Return a row per case and policy, of policies that follow velocities; pushes of one velocity are one row."""
    found = []
    for group in LIMITS:
        for place, policy in enumerate(policies):
            failed = {each.case for summary in policy.groups if summary.group == group for each in summary.failures}
            folded: dict[str, list[Outcome]] = {}
            for outcome in policy.cases:
                if outcome.group == group:
                    folded.setdefault(_folded(outcome), []).append(outcome)
            found += [_case_row(policy.label, name, members, failed, place == 0) for name, members in folded.items()]
    return found


def markdown(policies: Sequence[PolicyEvaluation], titles: Sequence[str] = TITLES) -> str:
    """Return the table for a model card, and what is asked in each group; how long it took is left out.

    Args:
        policies: Of the suite.
        titles: `TITLES`, or `CASE_TITLES` for a table of cases.
    """
    kept = [column for column, title in enumerate(titles) if title != "time [s]"]
    made = rows(policies) if titles is TITLES else case_rows(policies)
    table = [titles, ["---" if title in LEFT else "---:" for title in titles], *made]
    groups = {summary.group for policy in policies for summary in policy.groups}
    asked = [f"- `{group}`: {limit}" for group, limit in LIMITS.items() if group in groups]
    return "\n".join([*(_line([row[column] for column in kept]) for row in table), "", *asked])


def _row(policy: str, summary: Summary, *, is_judged: bool) -> tuple[str, ...]:
    drift, failed = summary.drift, len(summary.failures)
    verdict = f"{failed} failed" if failed else "kept"
    return (
        summary.group,
        policy,
        str(summary.runs),
        str(summary.falls),
        *(_number(error) for error in (summary.mean_joint_error_rad, summary.worst_joint_error_rad)),
        f"{math.degrees(summary.lean_rad):.0f}",
        *(_number(value) for value in ((drift.end_m, drift.greatest_m, drift.yaw_rad) if drift else [None] * 3)),
        verdict if is_judged else f"({verdict})",
        f"{summary.wall_s:.1f}",
        summary.worst,
    )


def _folded(outcome: Outcome) -> str:
    """Return the case of a row: of a push what is done and how hard it is, without direction and instant."""
    return outcome.case.partition(" towards")[0] if outcome.group == "push" else outcome.case


def _case_row(
    policy: str, name: str, members: Sequence[Outcome], failed: Collection[str], is_judged: bool
) -> tuple[str, ...]:
    one = members[0] if len(members) == 1 else None
    stretch, velocity = (one.stretch, one.velocity) if one is not None and any(one.asked) else (None, None)
    count = sum(member.case in failed for member in members)
    verdict = "kept" if not count else f"{count} failed" if one is None else "failed"
    return (
        members[0].group,
        policy,
        name if one is not None else f"{name}, {len(members)} times",
        " ".join(f"{value:+z.2f}" for value in stretch.measured) if stretch is not None else _NOTHING,
        " ".join(f"{value:.2f}" for value in velocity.error) if velocity is not None else _NOTHING,
        str(sum(len(member.falls) for member in members)),
        _number(one.drift.greatest_m if one is not None and one.drift is not None else None),
        f"{max(_jump(member) for member in members):.2f}",
        verdict if is_judged else f"({verdict})",
    )


def _jump(outcome: Outcome) -> float:
    return outcome.target_step if outcome.turns is None else outcome.turns.target_step


def _number(value: float | None) -> str:
    return _NOTHING if value is None else f"{value:.3f}"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
