"""Verdicts, and the table that they end in."""

from __future__ import annotations

from typing import Any

import pytest

from station.control.rig import RigConfig
from station.suite import table
from station.suite.judge import failure, judge
from station.suite.outcome import Drift, FallOutcome, Outcome
from station.suite.run import PolicyEvaluation


def outcome(**changes: Any) -> Outcome:
    plain = {
        "case": "a", "group": "track", "falls": (), "joint_error_rad": 0.05, "lean_rad": 0.1, "drift": None,
        "simulated_s": 10.0, "wall_s": 0.5,
    }  # fmt: skip
    return Outcome(**{**plain, **changes})


def fell(at_s: float, *contacts: str) -> FallOutcome:
    return FallOutcome(at_s=at_s, lean_rad=1.1, contacts=contacts, gate="returning")


def stood(end_m: float, greatest_m: float, *falls: FallOutcome, turned: float = 0.0) -> Outcome:
    drift = None if falls else Drift(end_m=end_m, greatest_m=greatest_m, yaw_rad=turned)
    return outcome(group="stand", joint_error_rad=None, drift=drift, falls=falls)


def test_a_fall_breaks_the_promise_of_every_group_and_says_when_why_and_how_often() -> None:
    for group in ("stand", "track", "push", "gate"):
        assert failure(outcome(group=group, falls=(fell(3.5),))) == "fell at 3.50 s (returning, leaned 63°)"
    said = failure(outcome(group="arms", falls=(fell(3.5, "left_knee_link"), fell(9.0))))
    assert "left_knee_link on the ground" in said
    assert said.endswith("and 1 times more")


@pytest.mark.parametrize("group", ["track", "unseen"])
def test_clips_must_be_tracked_to_a_tenth_of_a_radian(group: str) -> None:
    assert failure(outcome(group=group, joint_error_rad=0.1)) == ""
    assert failure(outcome(group=group, joint_error_rad=0.101)).startswith("mean joint error 0.101 rad")
    assert failure(outcome(group=group, joint_error_rad=None)).startswith("nothing was tracked")


@pytest.mark.parametrize("group", ["push", "arms", "late", "gate"])
def test_elsewhere_the_joint_error_is_only_reported(group: str) -> None:
    assert failure(outcome(group=group, joint_error_rad=0.3)) == ""


def test_drift_is_held_against_the_other_policy_in_the_same_run() -> None:
    other = stood(0.05, 0.08)
    assert failure(stood(0.0509, 0.0809), other) == ""
    assert failure(stood(0.052, 0.08), other).startswith("drifted 0.052 m in the end, the policy it is held against")
    assert failure(stood(0.05, 0.082), other).startswith("drifted 0.082 m at most")
    assert failure(stood(0.05, 0.08, turned=-0.02), other).startswith("turned -0.020 rad")
    assert failure(stood(9.0, 9.0)) == "", "with nothing to be held against, it is reported"
    assert failure(stood(9.0, 9.0), stood(0, 0, fell(1.0))) == "", "who fell is no measure"


def test_a_group_is_summed_up_with_its_worst_case() -> None:
    made = [
        outcome(case="lags", joint_error_rad=0.2), outcome(case="good", joint_error_rad=0.04),
        outcome(group="gate", case="leans", lean_rad=0.5), outcome(group="gate", case="late", falls=(fell(9.0),)),
        outcome(group="gate", case="early", falls=(fell(2.0),)),
    ]  # fmt: skip
    track, gate = judge(made)
    assert (track.group, track.runs, track.falls, track.worst) == ("track", 2, 0, "lags")
    assert track.mean_joint_error_rad == pytest.approx(0.12)
    assert [found.case for found in track.failures] == ["lags"]
    assert (gate.runs, gate.falls, gate.worst) == (3, 2, "early")
    assert [found.case for found in gate.failures] == ["late", "early"]


def evaluated(label: str, *outcomes: Outcome) -> PolicyEvaluation:
    return PolicyEvaluation(label=label, rig=RigConfig(), cases=list(outcomes), groups=judge(outcomes))


def test_policies_stand_below_each_other_by_group_and_only_the_first_is_judged() -> None:
    ours = evaluated("ours", stood(0.01, 0.02), outcome(joint_error_rad=0.2))
    theirs = evaluated("theirs", stood(0.03, 0.04), outcome(joint_error_rad=0.3))
    rows = table.rows([ours, theirs])
    assert [row[:2] for row in rows] == [("stand", "ours"), ("stand", "theirs"), ("track", "ours"), ("track", "theirs")]
    verdict = table.TITLES.index("verdict")
    assert [row[verdict] for row in rows] == ["kept", "(kept)", "1 failed", "(1 failed)"]
    assert all(len(row) == len(table.TITLES) for row in rows)


def test_markdown_is_a_table_that_says_what_was_asked() -> None:
    lines = table.markdown([evaluated("ours", stood(0.01, 0.02))]).splitlines()
    assert {line.count("|") for line in lines[:3]} == {len(table.TITLES)}, "a title less, a line more"
    assert lines[-1] == "- `stand`: no fall, and no further drift or turn than the policy it is held against"
