"""The suite of a policy that follows velocities: its cases, their verdicts, and real runs of one that only stands."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from station.control.rig import RigConfig
from station.control.tracking import VelocityFound, VelocityStretch
from station.errors import ConfigError, UsageError
from station.suite import promise, run, table
from station.suite.cases import STILL, Case, Cease, HandOver, Push, Velocity, Walk
from station.suite.judge import failure, judge
from station.suite.outcome import Ceased, FallOutcome, Outcome, TurnsTaken
from station.suite.promise import FULL, QUICK, velocity_cases
from station.suite.run import PolicyEvaluation
from station.suite.trial import run_case
from tests.adapters.policies.velocity_inputs import onnx_file
from tests.suite.made import TRACKER

LOWER, UPPER = np.array([-1.0, -0.5, -1.0]), np.array([2.0, 0.5, 1.0])
AHEAD: Velocity = (0.5, 0.0, 0.0)


@pytest.fixture(scope="module")
def statue(tmp_path_factory: pytest.TempPathFactory) -> RigConfig:
    """A dog that stands as it is, whatever it is asked for."""
    network = onnx_file(tmp_path_factory.mktemp("statue") / "statue.onnx", 48, 12, scale=0.0)
    return RigConfig(robot="go1-mujoco", policy="playground-go1", checkpoint=str(network))


def walks(made: list[Case], group: str) -> list[Velocity]:
    return [case.velocity for case in made if isinstance(case, Walk) and case.group == group]


def test_each_axis_is_walked_both_ways_at_two_shares_of_what_was_trained_and_in_curves() -> None:
    made = velocity_cases(FULL, LOWER, UPPER)
    ends = [(2.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, -0.5, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]
    halves = [tuple(0.5 * value for value in end) for end in ends]
    assert set(walks(made, "follow")) == {*ends, *halves, (1.0, 0.0, 0.5), (1.0, 0.0, -0.5)}
    assert walks(made, "late") == [(1.0, 0.0, 0.0), (1.0, 0.0, 0.5)]
    pushes = [case for case in made if isinstance(case, Push)]
    assert {(case.velocity, case.speed_mps) for case in pushes} == {(STILL, 0.4), ((1.0, 0.0, 0.0), 0.3)}
    assert {round(math.degrees(case.towards_rad)) for case in pushes} == set(range(0, 360, 45))


def test_cases_have_names_of_their_own_groups_can_be_picked_and_quick_is_less_of_each() -> None:
    made, quick = velocity_cases(FULL, LOWER, UPPER), velocity_cases(QUICK, LOWER, UPPER)
    assert [name for name, count in Counter((case.group, case.name) for case in made).items() if count > 1] == []
    groups = ["stand", "follow", "push", "late", "gate", "envelope", "hand-over"]
    assert list(dict.fromkeys(case.group for case in made)) == groups
    assert list(dict.fromkeys(case.group for case in quick)) == groups
    assert sum(case.seconds for case in quick) < 0.5 * sum(case.seconds for case in made)
    assert {case.group for case in velocity_cases(FULL, LOWER, UPPER, ["gate"])} == {"gate"}


def test_what_cannot_be_asked_for_is_left_out_and_another_policy_takes_turns() -> None:
    made = velocity_cases(QUICK, np.zeros(3), np.array([1.0, 0.0, 0.0]), hand_over=("other", "other.onnx"))
    assert walks(made, "follow") == [AHEAD]
    turns = [case for case in made if isinstance(case, HandOver)]
    assert {(case.policy, case.checkpoint) for case in turns} == {("other", "other.onnx")}
    assert turns[1].name == "vx +0.5, taking turns with other"


def outcome(**changes: Any) -> Outcome:
    plain = {
        "case": "vx +0.5", "group": "follow", "falls": (), "joint_error_rad": None, "lean_rad": 0.1, "drift": None,
        "simulated_s": 13.0, "wall_s": 0.5, "asked": AHEAD,
    }  # fmt: skip
    return Outcome(**{**plain, **changes})


def followed(*measured: float, asked: Velocity = AHEAD) -> Outcome:
    stretches = (VelocityStretch(0.0, 9.0, STILL, STILL), VelocityStretch(2.0, 8.0, asked, measured))  # type: ignore[arg-type]
    return outcome(asked=asked, velocity=VelocityFound((0.1, 0.0, 0.0), stretches))


@pytest.mark.parametrize(
    ("outcome", "reason"),
    [
        (followed(0.15, 0.3, 0.0), ""),
        (followed(0.14, 0.0, 0.0), "vx +0.14 of +0.50"),
        (followed(-0.5, 0.0, 0.0), "vx -0.50 of +0.50"),
        (followed(0.0, 0.0, -0.2, asked=(0.0, 0.0, -0.5)), ""),
        (followed(0.4, 0.0, 0.0, asked=(0.5, 0.0, 0.5)), "wz +0.00 of +0.50"),
        (followed(math.nan, 0.0, 0.0), "vx +nan of +0.50"),
        (outcome(), "not followed for long enough"),
    ],
)
def test_a_share_of_each_velocity_that_is_asked_for_has_to_come(outcome: Outcome, reason: str) -> None:
    said = failure(outcome)
    assert said.startswith(reason) or reason in said
    assert bool(said) == bool(reason)


@pytest.mark.parametrize(
    ("ceased", "reason"),
    [
        (Ceased(zero_after_s=0.32, greatest_step=0.1), ""),
        (Ceased(zero_after_s=0.34, greatest_step=0.1), "until 0.34 s after the last"),
        (Ceased(zero_after_s=0.1, greatest_step=1.0), "stepped by 1.00 of itself"),
    ],
)
def test_a_velocity_fades_in_time_and_without_a_step(ceased: Ceased, reason: str) -> None:
    said = failure(outcome(group="gate", ceased=ceased))
    assert (reason in said) if reason else not said


def turns(during: float, beside: float, count: int = 12, refusal: str = "") -> Outcome:
    taken = TurnsTaken(count=count, refusal=refusal, target_step=during, target_step_else=beside)
    return outcome(group="hand-over", turns=taken)


def test_targets_may_step_in_a_hand_over_as_far_as_joints_can_or_the_policies_do_by_themselves() -> None:
    assert failure(turns(1.0, 0.2)) == ""
    assert failure(turns(2.2, 1.5)) == ""
    assert failure(turns(1.01, 0.2)).startswith("a target jumped 1.01 times as far as its joint can move, 1.00 is")
    assert failure(turns(2.3, 1.5)).startswith("a target jumped 2.30")


def test_a_policy_that_does_not_take_over_fails() -> None:
    assert failure(turns(0.1, 0.1, count=3, refusal="too fast")) == "a policy did not take over: too fast"
    assert failure(turns(0.1, 0.1, count=0)) == "no policy took over"


def test_a_row_says_what_was_asked_and_measured_and_pushes_of_one_velocity_are_one_row() -> None:
    fell = FallOutcome(at_s=3.0, lean_rad=1.1, contacts=(), gate="tracking")
    pushed = [
        outcome(case=f"standing, 0.4 m/s towards {k}° at 3 s", group="push", falls=(fell,) * (k == 90), asked=STILL)
        for k in (0, 90)
    ]
    outcomes = [followed(0.42, -0.02, 0.0), *pushed]
    policy = PolicyEvaluation(label="walker", rig=RigConfig(), cases=outcomes, groups=judge(outcomes))
    walk, push = table.case_rows([policy])
    assert walk == ("follow", "walker", "vx +0.5", "+0.42 -0.02 +0.00", "0.10 0.00 0.00", "0", "–", "0.00", "kept")
    assert (push[2], push[5], push[-1]) == ("standing, 0.4 m/s, 2 times", "1", "1 failed")
    lines = table.markdown([policy], table.CASE_TITLES).splitlines()
    assert {line.count("|") for line in lines[:4]} == {len(table.CASE_TITLES) + 1}


def test_one_that_only_stands_is_measured_as_standing(statue: RigConfig) -> None:
    seconds = promise.STARTS_S + promise.WALKED_S
    found = run_case(Walk(group="follow", seconds=seconds, velocity=AHEAD), statue)
    assert found.falls == ()
    assert found.stretch is not None
    assert found.stretch.commanded == AHEAD
    assert found.stretch.measured == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    assert found.velocity is not None
    assert found.velocity.error[0] == pytest.approx(0.5 * 8 / 9, abs=0.05), "the first second enters, the next stands"
    assert failure(found).startswith("vx ")
    assert found.trace is not None
    assert len(found.trace.times_s) == len(found.trace.measured) == len(found.trace.commanded) > 70
    assert len(found.trace.path) == 100


def test_commands_that_cease_are_faded_and_come_back(statue: RigConfig) -> None:
    found = run_case(Cease(group="gate", seconds=promise.COMES_BACK_S + 3.0, velocity=AHEAD), statue)
    assert found.ceased is not None
    assert 0.2 < found.ceased.zero_after_s <= promise.ZERO_AFTER_S
    assert 0.05 < found.ceased.greatest_step < promise.FADE_STEP
    assert found.drift is not None
    assert failure(found) == ""
    assert found.trace is not None
    assert any(math.isnan(time_s) for time_s in found.trace.times_s), "curves have a gap where nothing was followed"


def test_policies_take_turns_as_often_as_is_said_and_it_is_the_same_each_time(
    statue: RigConfig, tmp_path: Path
) -> None:
    other = str(onnx_file(tmp_path / "other.onnx", 48, 12, scale=0.01))
    seconds = 3.5 * promise.TURN_EVERY_S
    case = HandOver(group="hand-over", seconds=seconds, velocity=AHEAD, policy="playground-go1", checkpoint=other)
    first, again = (msgspec.structs.replace(run_case(case, statue), wall_s=0.0) for _ in range(2))
    assert msgspec.json.encode(first) == msgspec.json.encode(again)
    assert first.turns is not None
    assert (first.turns.count, first.turns.refusal) == (3, "")
    assert failure(first) == ""


def test_a_policy_of_velocities_has_a_suite_of_its_own(statue: RigConfig) -> None:
    planned = run.plan([statue], extent=QUICK, jobs=1)
    assert planned.missing == []
    assert {case.group for case in planned.cases} == {
        "stand",
        "follow",
        "push",
        "late",
        "gate",
        "envelope",
        "hand-over",
    }
    assert max(case.velocity for case in planned.cases if isinstance(case, Walk))[0] == pytest.approx(0.75)


@pytest.mark.assets
def test_of_a_command_with_a_posture_and_arms_the_velocities_are_asked_for(assets: Path) -> None:
    falcon = RigConfig(robot="g1-mujoco", policy="falcon", checkpoint=str(assets / "zoo/policies/falcon_g1_29dof.onnx"))
    planned = run.plan([falcon], extent=QUICK, jobs=1)
    assert max(case.velocity for case in planned.cases if isinstance(case, Walk)) == (0.5, 0.0, 0.5)
    found = run_case(Cease(group="gate", seconds=promise.COMES_BACK_S + 1.0, velocity=AHEAD), falcon)
    assert failure(found) == "", "that its height stays is as it should be"


def test_what_has_no_place_in_a_suite_is_refused_in_a_line(statue: RigConfig) -> None:
    with pytest.raises(UsageError, match="'playground-go1' follows velocities; its suite plays no motions"):
        run.plan([statue], extent=QUICK, named=["builtin:wave"])
    with pytest.raises(UsageError, match="the suite of policy 'playground-go1' has no group track"):
        run.plan([statue], extent=QUICK, only=["track"])
    with pytest.raises(UsageError, match="--hand-over: policy 'tracker' follows no velocities"):
        run.plan([TRACKER], extent=QUICK, hand_over=("twist2", ""))
    with pytest.raises(ConfigError, match="drives 12 joints, the robot has 29"):
        run.plan([msgspec.structs.replace(statue, robot="g1-mujoco")], extent=QUICK)


def test_walks_are_drawn_row_by_row(tmp_path: Path) -> None:
    from station.view import plot_style as style
    from station.view.velocity_plot import Walk as Row
    from station.view.velocity_plot import save_walks
    from tests.view.pictures import pixels, share

    times = np.arange(50) * 0.1
    row = Row("vx +0.5", times, np.tile(AHEAD, (50, 1)), np.tile([0.4, 0.0, 0.0], (50, 1)), np.zeros((50, 2)))
    empty = Row("fell at once", [], [], [], [[0.0, 0.0]])
    one, two = (pixels(save_walks(rows, tmp_path / "walks.png")) for rows in ([row], [row, empty]))
    assert two.shape[0] > one.shape[0] + 100
    assert share(one, style.ASKED) > 0.002
    assert share(one, style.MEASURED) > 0.001
