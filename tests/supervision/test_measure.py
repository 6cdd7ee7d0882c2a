"""A runbook measures what a stream says, compares it, and keeps it; and it keeps what a person answers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from station.api.episode import open_episode
from station.contract import elements
from station.episode.storage.manifest import load_manifest
from station.life.stop_button import StopButton
from station.supervision.figures import Bounds, Figure, number, table
from station.supervision.measuring import Spread
from tests.supervision.place import HEAD, MOTION, RECORDER, Person, Place

PAIR = elements((("left_winding", "right_winding"), "degC"))


def measured(expect: str, *, stream: str = "action_body", for_: str = "500ms", more: str = "") -> str:
    """Return a step that measures the commands of a motion."""
    return f"  - measure: the commands\n    stream: {stream}\n    for: {for_}\n    expect: {expect}\n{more}"


def book(step: str) -> str:
    return HEAD + "steps:\n" + RECORDER + MOTION + step


@dataclass
class Onlooker(Person):
    """Does something once, when a measurement shows that it goes on."""

    acts: object = None

    def begin(self, step: str) -> None:
        super().begin(step)
        if " of 30 s" in step and callable(self.acts):
            act, self.acts = self.acts, None
            act()


def test_what_was_measured_is_shown_and_stands_in_the_episode(place: Place) -> None:
    person = Person(word="limp")
    step = measured('{rate: {least: 10}, "left_knee*": {least: -3, most: 3}, "*_pos": {}}')
    ask = '  - ask: "Is it limp?"\n    answers: [limp, stiff]\n'
    session = place.session(book(step + ask), person, record=True)
    assert session.run(place.stop, for_s=0.1) == 0, person.told
    assert person.heard("as expected: at least 10")
    assert person.heard("as expected: -3 to 3")
    assert person.heard("done measure: the commands: as expected")
    assert session.episode is not None
    assert session.episode.path is not None
    manifest = load_manifest(Path(session.episode.path))
    answers = {answer["step"]: answer["answer"] for answer in manifest.runbook["answers"]}
    assert answers["ask: Is it limp?"] == "limp"
    assert answers["measure: the commands"].startswith("rate: ")
    said = open_episode(session.episode.path).events()
    events = {event.value["name"]: event.value["detail"] for event in said}
    figures = {figure["name"]: figure for figure in events["measured"]["figures"]}
    assert events["measured"]["what"] == "the commands"
    assert figures["rate"]["numbers"]["value"] > 10.0
    assert figures["left_knee*"]["numbers"]["least_at"] == "left_knee_pos"
    assert figures["faults"]["is_good"]
    assert (events["answered"]["question"], events["answered"]["answer"]) == ("Is it limp?", "limp")


def test_what_is_not_as_expected_ends_it_unless_the_runbook_goes_on(place: Place) -> None:
    person = Person()
    step = measured('{rate: {most: 1}, "left_knee*": {least: 4}}')
    assert place.session(book(step), person).run(place.stop) == 1
    (line,) = [told for told in person.told if told.startswith("error failed: ")]
    assert line.startswith("error failed: the commands: rate is not as expected (at most 1): ")
    assert "; nor are left_knee*; look at it before you go on" in line
    assert person.heard("NOT as expected: at least 4")
    goes_on = Person()
    assert place.session(book(step + "    if_not: continue\n"), goes_on).run(place.stop, for_s=0.1) == 0
    assert goes_on.heard("not as expected: rate, left_knee*; goes on")


@pytest.mark.parametrize(
    ("step", "line"),
    [
        (
            measured("{}", stream="action_bdy"),
            "stream 'action_bdy': nothing describes it (did you mean 'action_body'?)",
        ),
        (measured("{left_kne_pos: {most: 1}}"), "it has no number 'left_kne_pos' (did you mean 'left_knee_pos'?)"),
        (measured("{}", stream="command_gate"), "it holds json; expected one of numbers with names"),
        (measured("{}", stream="target"), "nothing came in 0.5 s; is its writer running?"),
        (measured("{}", more="    follows: action_hand_left\n"), "have no number of the same name"),
        (
            "  - measure: m\n    stream: action_body\n    for: 1s\n"
            '    after_commands: {torque: "*_pos", speed: "left_knee_pos"}\n',
            "numbers are called *_pos and 1 left_knee_pos; expected the torque and the speed of the same joints",
        ),
    ],
)
def test_what_cannot_be_measured_is_one_line_that_names_it(place: Place, step: str, line: str) -> None:
    person = Person()
    steps = book(step).replace(RECORDER, "")
    assert place.session(steps, person).run(place.stop, for_s=0.1) == 1
    (told,) = [told for told in person.told if told.startswith("error failed: ")]
    assert line in told, told
    assert "\n" not in told


def test_asked_to_stop_while_it_measures_it_stops(place: Place) -> None:
    person = Onlooker(acts=place.stop.set)
    assert place.session(book(measured("{}", for_="30s")), person).run(place.stop) == 130
    assert person.heard("info stopped: asked to stop while it was measured")
    assert place.supervisor.children == {}


def test_a_server_that_dies_meanwhile_and_an_emergency_stop_end_it(place: Place) -> None:

    def kill() -> None:
        place.supervisor.children["motion"].process.kill()

    person = Onlooker(acts=kill)
    assert place.session(book(measured("{}", for_="30s")), person).run(place.stop) == 1
    assert person.heard("error failed: server 'motion' was killed by SIGKILL while it was measured")

    def press() -> None:
        with StopButton(place.bus.address, who="anna") as button:
            button.press("smoke")

    stopped = Onlooker(acts=press)
    try:
        assert place.session(book(measured("{}", for_="30s")), stopped).run(place.stop) == 1
        assert stopped.heard("smoke")
    finally:
        with StopButton(place.bus.address, who="anna") as button:
            button.release("tested")


def test_a_question_that_nobody_answers_ends_it_and_with_yes_it_is_not_asked(place: Place) -> None:
    ask = '  - ask: "Is it limp?"\n    answers: [limp, stiff]\n'
    silent = Person()
    assert place.session(book(ask), silent).run(place.stop) == 1
    assert silent.heard("error failed: not answered: Is it limp?")
    session = place.session(book(ask), Person(), unattended=True)
    assert session.run(place.stop, for_s=0.1) == 0
    assert [(answer.answer, answer.is_unattended) for answer in session.answers] == [("not asked", True)]


def test_a_spread_says_whose_the_extremes_are_and_no_number_is_never_good() -> None:
    spread = Spread(2)
    spread.add(np.array([[20.0, 30.0], [22.0, 75.0]]))
    spread.add(np.empty((0, 2)))
    figure = spread.figure("*_winding", [0, 1], PAIR, Bounds(most=70.0))
    assert figure.text == "20 (left_winding) to 75 (right_winding), mean 36.75 degC"
    assert (figure.expected, figure.is_good) == ("at most 70", False)
    assert figure.numbers["most_at"] == "right_winding"
    spread.add(np.array([[np.nan, 30.0]]))
    assert not spread.figure("*_winding", [0, 1], PAIR, Bounds(least=0.0)).is_good
    assert not spread.figure("*_winding", [0, 1], PAIR, Bounds()).is_good


def test_bits_of_an_error_are_shown_as_such() -> None:
    spread = Spread(2)
    spread.add(np.array([[0.0, float(0x40000001)]]))
    figure = spread.figure("*_error", [0, 1], elements((("knee_error", "hip_error"), "")), Bounds(most=0.0))
    assert figure.text.startswith("0 (knee_error) to 0x40000001 (hip_error), mean ")
    assert not figure.is_good


def test_figures_are_shown_as_a_table() -> None:
    figures = [number("rate", 499.96, "Hz", Bounds(least=499.0, most=501.0)), Figure(name="motors", text="limp")]
    assert table(figures) == ["  rate    500 Hz  as expected: 499 to 501", "  motors  limp"]
