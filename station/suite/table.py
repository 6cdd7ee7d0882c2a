"""The table of a suite: cells for a terminal, a text file or a model card."""

from __future__ import annotations

import math
from collections.abc import Sequence

from station.suite.judge import Summary
from station.suite.promise import LIMITS
from station.suite.run import PolicyEvaluation

TITLES = (
    "group", "policy", "runs", "falls", "error [rad]", "worst", "lean [°]", "drift [m]", "most", "yaw [rad]",
    "verdict", "time [s]", "worst case",
)  # fmt: skip
"""Errors are means over the cases and of the worst case; a drift is that in the end and at most."""

LEFT = {"group", "policy", "verdict", "worst case"}
_NOTHING = "–"


def rows(policies: Sequence[PolicyEvaluation]) -> list[tuple[str, ...]]:
    """Return a row per group and policy, the policies of a group below each other; only the first one is judged."""
    found = []
    for group in LIMITS:
        for place, policy in enumerate(policies):
            found += [_row(policy.label, row, is_judged=place == 0) for row in policy.groups if row.group == group]
    return found


def markdown(policies: Sequence[PolicyEvaluation]) -> str:
    """Return the table for a model card, and what is asked in each group; how long it took is left out."""
    kept = [column for column, title in enumerate(TITLES) if title != "time [s]"]
    table = [TITLES, ["---" if title in LEFT else "---:" for title in TITLES], *rows(policies)]
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


def _number(value: float | None) -> str:
    return _NOTHING if value is None else f"{value:.3f}"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
