"""Runbooks are validated before anything starts; every mistake names file, step and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from servers.motion import MotionConfig
from station.errors import BadFile, ConfigError, StationError, UsageError
from station.supervision import runbook
from station.supervision.checks import DiskCheck
from station.supervision.figures import Bounds
from station.supervision.runbook import (
    Arming,
    CheckStep,
    ConfirmStep,
    MeasureStep,
    QuestionStep,
    StartStep,
    TakingOver,
)

GOOD = """
runbook: test
robot: unitree_g1_with_hands
steps:
  - check: disk
    min_free_gb: 1
  - confirm: "Nobody stands there."
  - start: motion
    with: {motion: "a.pkl", rate_hz: 25}
    ready_within: 90s
  - note: "Look at it."
on_failure: [stop: motion]
"""


def load(tmp_path: Path, text: str, *sets: str) -> runbook.Runbook:
    path = tmp_path / "book.yaml"
    path.write_text(text)
    return runbook.load(path, sets)


def test_steps_come_out_typed_and_in_order(tmp_path: Path) -> None:
    book = load(tmp_path, GOOD)
    assert [type(step).__name__ for step in book.steps] == ["CheckStep", "ConfirmStep", "StartStep", "NoteStep"]
    check, confirm, start, _ = book.steps
    assert isinstance(check, CheckStep)
    assert check.what == DiskCheck(min_free_gb=1.0)
    assert isinstance(confirm, ConfirmStep)
    assert confirm.confirm == "Nobody stands there."
    assert isinstance(start, StartStep)
    assert start.config == MotionConfig(motion="a.pkl", rate_hz=25.0)
    assert start.ready_within_s == 90.0
    assert book.stop_order == ("motion",)


def test_a_robot_is_armed_and_disarmed_by_steps_that_follow_the_start_of_its_server(tmp_path: Path) -> None:
    steps = GOOD.replace("  - note", "  - arm: motion\n    within: 4s\n  - disarm: motion\n  - arm:\n  - note")
    *_, arm, disarm, every, _ = load(tmp_path, steps).steps
    assert [str(step) for step in (arm, disarm, every)] == ["arm motion", "disarm motion", "arm"]
    assert isinstance(arm, CheckStep)
    assert arm.what == Arming(action="arm", server="motion", within_s=4.0)
    assert isinstance(every, CheckStep)
    assert every.what == Arming(action="arm", server="")


def test_a_step_has_another_policy_of_a_server_before_it_take_over(tmp_path: Path) -> None:
    g1 = "  - start: g1\n    with: {policies: {stiff: {policy: tracker}}}\n"
    steps = GOOD.replace(
        "  - note", f"{g1}  - policy: stiff\n    within: 4s\n  - policy: tracker\n    robot: g1\n  - note"
    )
    *_, first, second, _ = load(tmp_path, steps).steps
    assert [str(step) for step in (first, second)] == ["policy stiff", "policy tracker robot=g1"]
    assert isinstance(first, CheckStep)
    assert first.what == TakingOver(policy="stiff", within_s=4.0)
    with pytest.raises(
        ConfigError, match=r"step 5: policy stif \(did you mean 'stiff'\?\): .*; by then: stiff, tracker$"
    ):
        load(tmp_path, GOOD.replace("  - note", f"{g1}  - policy: stif\n  - note"))


def test_a_measurement_and_a_question_come_out_typed(tmp_path: Path) -> None:
    more = """  - measure: "it is cool"
    stream: state_samples
    for: 2min
    expect: {rate: {least: 499, most: 501}, "*_winding": {most: 70}}
    if_not: continue
  - ask: "Is it limp?"
    answers: [yes, no, half]
  - note"""
    *_, measure, question, _ = load(tmp_path, GOOD.replace("  - note", more)).steps
    assert isinstance(measure, MeasureStep)
    assert (measure.what.for_s, measure.what.if_not) == (120.0, "continue")
    assert measure.what.expect == {"rate": Bounds(least=499.0, most=501.0), "*_winding": Bounds(most=70.0)}
    assert question == QuestionStep(ask="Is it limp?", answers=("yes", "no", "half"))
    assert [str(step) for step in (measure, question)] == ["measure: it is cool", "ask: Is it limp?"]


MEASURE = "  - measure: cool\n    stream: state_samples\n    for: 2s\n"


@pytest.mark.parametrize(
    ("step", "message"),
    [
        (MEASURE.replace("2s", "0s"), "step 4 (measure): for is 0 s; expected more than 0"),
        (MEASURE.replace("2s", "soon"), "step 4: for: expected a duration such as 20s, 500ms or 2min, got 'soon'"),
        (MEASURE.replace("    for: 2s\n", ""), "step 4 (measure): missing key for"),
        (MEASURE.replace("stream", "straem"), "step 4: unknown key 'straem' (did you mean 'stream'?)"),
        (MEASURE + "    expect: {rate: {leat: 4}}\n", "unknown key 'leat' (did you mean 'least'?)"),
        (MEASURE + "    expect: {rate: {least: 4, most: 3}}\n", "least is 4 and most is 3; expected the smaller one"),
        (MEASURE + "    expect: {rate: fast}\n", "step 4 (measure): expect"),
        (
            MEASURE + "    follows: target\n    expect: {ledd: {least: 4}}\n",
            "expect: 'ledd' is no figure here (did you mean 'led'?); known: rate, led",
        ),
        (
            MEASURE + "    after_commands: {torque: a, speed: b}\n    expect: {led: {least: 4}}\n",
            "expect: 'led' is no figure here; known: rate, after",
        ),
        (MEASURE + "    after_commands: {torque: a}\n", "step 4 (measure): after_commands: missing key speed"),
        (
            MEASURE + "    follows: x\n    after_commands: {torque: a, speed: b}\n",
            "expected one of them; give the other",
        ),
        (MEASURE + "    if_not: go\n", "if_not: expected continue or stop, got 'go'"),
        ("  - ask: limp?\n", "step 4: missing key answers"),
        ("  - ask: limp?\n    answers: [limp]\n", "step 4: answers: expected two words at least, got 1"),
        ("  - ask: limp?\n    answers: [limp, else]\n", "answers: 'else' cannot be typed: expected letters, digits"),
        ("  - ask: limp?\n    answers: [limp, a bit]\n", "since SPACE and e are the emergency stop"),
    ],
)
def test_a_mistake_in_a_measurement_or_a_question_is_one_line(tmp_path: Path, step: str, message: str) -> None:
    with pytest.raises(StationError) as caught:
        load(tmp_path, GOOD.replace("  - note", f"{step}  - note"))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


def test_what_moves_a_robot_asks_before_it_starts_again_and_a_recorder_does_not_unless_told_otherwise(
    tmp_path: Path,
) -> None:
    more = "    if_it_dies: restart\n    ready_within: 90s\n  - start: recorder\n  - start: g1\n    if_it_dies: end\n"
    book = load(tmp_path, GOOD.replace("    ready_within: 90s\n", more))
    assert [step.if_it_dies for step in book.servers] == ["restart", "restart", "end"]
    assert load(tmp_path, GOOD).servers[0].if_it_dies == "ask"


def test_several_servers_of_a_kind_have_names_of_their_own(tmp_path: Path) -> None:
    head_and_wrist = (
        "- start: head\n    server: camera\n    with: {source: mujoco}\n  - start: wrist\n    server: camera"
    )
    book = load(tmp_path, GOOD.replace("- note", f"{head_and_wrist}\n  - note"), "wrist.fps=15")
    _, head, wrist = book.servers
    assert [(step.start, step.kind.name) for step in (head, wrist)] == [("head", "camera"), ("wrist", "camera")]
    assert [str(step) for step in (head, wrist)] == [
        "start head (camera) source=mujoco",
        "start wrist (camera) fps=15.0",
    ]
    assert book.stop_order == ("motion", "wrist", "head")


def test_set_options_change_a_servers_configuration(tmp_path: Path) -> None:
    book = load(tmp_path, GOOD, "motion.motion=b.pkl", "motion.loop=true")
    assert book.servers[0].config == MotionConfig(motion="b.pkl", rate_hz=25.0, loop=True)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("- start: motion", "- start: moton", "unknown server 'moton' (did you mean 'motion'?)"),
        ("- start: motion", "- start: moves\n    server: moton", "unknown server 'moton' (did you mean 'motion'?)"),
        ("- start: motion", "- start: a/b\n    server: motion", "start: expected a name of letters, digits, - and _"),
        ("- confirm:", "- arm: motion\n  - confirm:", "step 2: arm motion: no step before it starts that server"),
        ("- note:", "- arm: moton\n  - note:", "step 4: arm moton (did you mean 'motion'?): no step before it starts"),
        ("- note:", "- arm: motion\n    wihin: 1s\n  - note:", "unknown key 'wihin' (did you mean 'within'?)"),
        ("- note:", "- arm: [1]\n  - note:", "step 4 (arm): "),
        ("- note:", "- policy: walker\n  - note:", "step 4: policy walker: no server that a step before it starts has"),
        ("- note:", "- policy: walker\n    robt: g1\n  - note:", "unknown key 'robt' (did you mean 'robot'?)"),
        ("- note:", "- policy:\n  - note:", "step 4 (policy): "),
        ("min_free_gb", "min_fre_gb", "step 1 (check disk): unknown key 'min_fre_gb' (did you mean 'min_free_gb'?)"),
        ("check: disk\n    min_free_gb: 1", "check: ping", "step 1 (check ping): missing key host"),
        ("- confirm:", "- confrim:", "step 2: unknown step 'confrim' (did you mean 'confirm'?)"),
        ("check: disk", "check: dsk", "step 1: unknown check 'dsk' (did you mean 'disk'?)"),
        ("rate_hz: 25", "rate_hs: 25", "step 3 (motion): unknown key 'rate_hs' (did you mean 'rate_hz'?)"),
        ("rate_hz: 25", "rate_hz: fast", "step 3 (motion): rate_hz: expected float, got 'fast'"),
        ('motion: "a.pkl", ', "", "step 3 (motion): missing key motion"),
        ("ready_within: 90s", "ready_within: soon", "step 3: ready_within: expected a duration"),
        ("ready_within: 90s", "ready_witin: 90s", "step 3: unknown key 'ready_witin' (did you mean 'ready_within'?)"),
        ("ready_within: 90s", "if_it_dies: restrt", "step 3: if_it_dies: expected ask, end, restart, got 'restrt'"),
        (
            GOOD[GOOD.index("steps:") : GOOD.index("on_f")],
            "steps: []\n",
            "starts nothing; expected at least one step such",
        ),
        ("robot: unitree_g1_with_hands\n", "", "missing key robot"),
        ("robot:", "robto:", "unknown key 'robto' (did you mean 'robot'?)"),
        ("stop: motion", "stop: g1", "on_failure stops 'g1'"),
    ],
)
def test_a_mistake_is_one_line_that_names_the_place(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(StationError) as caught:
        load(tmp_path, GOOD.replace(old, new))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


def test_every_runbook_that_ships_is_valid_and_says_what_it_is_for() -> None:
    assert set(runbook.shipped()) == {path.stem for path in Path("runbooks").glob("*.yaml")} > {"g1-sim-motion"}
    for name, path in runbook.shipped().items():
        book = runbook.load(path)
        assert (book.name, (book.robot, book.description)) == (name, runbook.describe(path))
        assert book.description


def test_the_name_of_one_that_ships_comes_before_a_folder_of_that_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "g1-demo").mkdir()
    (tmp_path / "mine").write_text(GOOD)
    assert runbook.find("g1-demo") == runbook.shipped()["g1-demo"]
    assert runbook.find("mine") == Path("mine")


@pytest.mark.parametrize("name", ["g1-sim-moton", "", "tests"])
def test_a_name_that_is_no_runbook_is_told_with_those_that_are(name: str) -> None:
    with pytest.raises(UsageError, match=r"one of commands-only, .*g1-sim-motion.*, or the path of a file of yours"):
        runbook.find(name)


def test_its_robot_is_not_compared_where_a_setting_of_the_robots_server_was_changed(tmp_path: Path) -> None:
    text = GOOD.replace("  - note", "  - start: g1\n  - note")
    assert load(tmp_path, text, "motion.loop=true").robot == "unitree_g1_with_hands"
    assert load(tmp_path, text, "g1.policy=twist").robot == ""


def test_a_missing_runbook_says_what_is_near() -> None:
    with pytest.raises(BadFile, match=r"did you mean 'g1-sim-motion\.yaml'"):
        runbook.load(runbook.find("runbooks/g1-sim-moton.yaml"))


def test_a_library_that_is_not_installed_is_told_before_anything_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = GOOD.replace('motion: "a.pkl"', 'motion: "builtin:wave"').replace("  - note", "  - start: gamepad\n  - note")
    book = load(tmp_path, text)
    book.expect_found()
    monkeypatch.setattr("station.libraries.version", lambda library: None)
    with pytest.raises(StationError) as caught:
        book.expect_found()
    assert str(caught.value) == (
        "runbook test step 4 (gamepad): device gamepad needs pygame, which is not installed; "
        "pip install 'teleop-station[gamepad]'"
    )
    assert caught.value.exit_code == 1
