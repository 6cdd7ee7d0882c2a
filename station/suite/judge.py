"""What the outcomes say: each is held against the limits, and each group is summed up."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from station.control.tracking import VELOCITIES
from station.suite.cases import Group
from station.suite.outcome import Ceased, Drift, Outcome, TurnsTaken
from station.suite.promise import (
    DRIFT_SLACK_M,
    FADE_STEP,
    FOLLOWED,
    JOINT_ERROR_RAD,
    JUMPS,
    LIMITS,
    TURN_SLACK_RAD,
    ZERO_AFTER_S,
)  # fmt: skip

_ROUNDING = 1e-9


class Failure(msgspec.Struct, frozen=True):
    """A case that did not keep the promise, and why."""

    case: str
    reason: str


class Summary(msgspec.Struct, frozen=True, kw_only=True):
    """A group of one policy.

    Attributes:
        group: Its name.
        runs, falls: How many; a run of random arms goes on after a fall.
        failures: The cases that did not keep the promise.
        worst: The case that went worst: fell first, else leaned most, in `track` and `unseen` tracked worst.
        mean_joint_error_rad, worst_joint_error_rad: Over the cases; None where nothing was tracked.
        lean_rad: How far the root leaned at most, over the cases [rad].
        drift: Of the case that drifted furthest, or None where nothing was to stand.
        simulated_s, wall_s: Sums over the cases [s].
    """

    group: Group
    runs: int
    falls: int
    failures: tuple[Failure, ...]
    worst: str
    mean_joint_error_rad: float | None
    worst_joint_error_rad: float | None
    lean_rad: float
    drift: Drift | None
    simulated_s: float
    wall_s: float


def judge(outcomes: Sequence[Outcome], against: Sequence[Outcome] = ()) -> list[Summary]:
    """Sum up each group that was run, in the order of the table.

    Args:
        outcomes: Of the policy.
        against: Of the one that it is held against, the same cases in the same order; none to let drift pass.
    """
    others: Sequence[Outcome | None] = against or [None] * len(outcomes)
    pairs = list(zip(outcomes, others, strict=True))
    groups = {group: [pair for pair in pairs if pair[0].group == group] for group in LIMITS}
    return [_summary(group, members) for group, members in groups.items() if members]


def failure(outcome: Outcome, against: Outcome | None = None) -> str:
    """Return why an outcome does not keep the promise, or "" when it does."""
    if outcome.falls:
        more = f", and {len(outcome.falls) - 1} times more" if len(outcome.falls) > 1 else ""
        return f"{outcome.falls[0]}{more}"
    error = outcome.joint_error_rad
    if outcome.group in ("track", "unseen") and (error is None or error > JOINT_ERROR_RAD):
        measured = "nothing was tracked" if error is None else f"mean joint error {error:.3f} rad"
        return f"{measured}, at most {JOINT_ERROR_RAD:.2f} rad is allowed"
    if outcome.group == "stand" and against is not None and not against.falls:
        return _drifted(outcome.drift, against.drift)
    return _of_velocities(outcome)


def _of_velocities(outcome: Outcome) -> str:
    if outcome.group == "follow":
        return _not_followed(outcome)
    if outcome.ceased is not None:
        return _not_ceased(outcome.ceased)
    return _jumped(outcome.turns) if outcome.turns is not None else ""


def _not_followed(outcome: Outcome) -> str:
    stretch = outcome.stretch
    if stretch is None:
        return "the velocity was not followed for long enough to be measured"
    for name, asked, came in zip(VELOCITIES, stretch.commanded, stretch.measured, strict=True):
        if asked and not came / asked >= FOLLOWED:
            return f"{name} {came:+.2f} of {asked:+.2f}, at least {FOLLOWED:g} of it is asked for"
    return ""


def _not_ceased(ceased: Ceased) -> str:
    if ceased.zero_after_s > ZERO_AFTER_S + _ROUNDING:
        return f"commanded a velocity until {ceased.zero_after_s:.2f} s after the last, {ZERO_AFTER_S:g} s is allowed"
    if ceased.greatest_step > FADE_STEP:
        return f"the velocity stepped by {ceased.greatest_step:.2f} of itself in a tick, {FADE_STEP:g} is allowed"
    return ""


def _jumped(turns: TurnsTaken) -> str:
    if turns.refusal:
        return f"a policy did not take over: {turns.refusal}"
    if not turns.count:
        return "no policy took over"
    allowed = max(1.0, JUMPS * turns.target_step_else)
    if turns.target_step > allowed:
        return f"a target jumped {turns.target_step:.2f} times as far as its joint can move, {allowed:.2f} is allowed"
    return ""


def _drifted(ours: Drift | None, theirs: Drift | None) -> str:
    if ours is None or theirs is None:
        return ""
    pairs = ((ours.greatest_m, theirs.greatest_m, "at most"), (ours.end_m, theirs.end_m, "in the end"))
    for mine, other, when in pairs:
        if mine > other + DRIFT_SLACK_M:
            return f"drifted {mine:.3f} m {when}, the policy it is held against {other:.3f} m"
    if abs(ours.yaw_rad) > abs(theirs.yaw_rad) + TURN_SLACK_RAD:
        return f"turned {ours.yaw_rad:+.3f} rad, the policy it is held against {theirs.yaw_rad:+.3f} rad"
    return ""


def _summary(group: Group, pairs: list[tuple[Outcome, Outcome | None]]) -> Summary:
    failures = [Failure(outcome.case, failure(outcome, other)) for outcome, other in pairs]
    outcomes = [outcome for outcome, _ in pairs]
    errors = [outcome.joint_error_rad for outcome in outcomes if outcome.joint_error_rad is not None]
    drifts = [outcome.drift for outcome in outcomes if outcome.drift is not None]
    return Summary(
        group=group,
        runs=len(outcomes),
        falls=sum(len(outcome.falls) for outcome in outcomes),
        failures=tuple(found for found in failures if found.reason),
        worst=max(outcomes, key=_badness).case,
        mean_joint_error_rad=sum(errors) / len(errors) if errors else None,
        worst_joint_error_rad=max(errors, default=None),
        lean_rad=max(outcome.lean_rad for outcome in outcomes),
        drift=max(drifts, key=lambda drift: drift.greatest_m, default=None),
        simulated_s=sum(outcome.simulated_s for outcome in outcomes),
        wall_s=sum(outcome.wall_s for outcome in outcomes),
    )


def _badness(outcome: Outcome) -> tuple[bool, float, float]:
    """Order outcomes: falls, the earlier the worse; then what the group is about."""
    first_s = outcome.falls[0].at_s if outcome.falls else 0.0
    is_tracking = outcome.group in ("track", "unseen")
    return bool(outcome.falls), -first_s, (outcome.joint_error_rad or 0.0) if is_tracking else outcome.lean_rad
