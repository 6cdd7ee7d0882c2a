"""What is told of an event."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from station.errors import BadFile, ConfigError
from station.life import events
from station.operator.phrases import LONGEST_WORDS, Phrase, Phrases, load
from station.operator.voice import Cue


def told(name: str, table: Phrases | None = None, **detail: Any) -> Cue | None:
    return (table or Phrases()).cue(events.make("teleop", name, **detail))


def words(name: str, table: Phrases | None = None, **detail: Any) -> str:
    cue = told(name, table, **detail)
    return "" if cue is None else cue.words


TAKE = "2026-11-21-g1-walk-0007"


@pytest.mark.parametrize(
    ("name", "detail", "said"),
    [
        ("operator-engaged", {}, "engaged"),
        ("operator-disengaged", {"reason": "released"}, "released"),
        ("operator-disengaged", {"reason": "pico is silent for 0.1 s"}, "let go: pico is silent for 0.1 s"),
        ("operator-refused", {"reason": "emergency stop; release it first"}, "refused: emergency stop"),
        ("operator-lost", {"device": "pico", "reason": "no headset"}, "pico lost"),
        ("operator-lost", {"device": "pico", "new": 72, "reason": "no headset"}, "pico lost"),
        ("operator-lost", {"device": "pico", "new": 0, "reason": "no headset"}, "waiting for pico"),
        ("record-start", {"episode_id": TAKE}, "recording take 7"),
        ("record-stop", {"episode_id": TAKE, "discarded": False}, "take 7 saved"),
        ("record-stop", {"episode_id": TAKE, "discarded": True}, "take 7 discarded"),
        ("mark", {"episode_id": TAKE, "label": "mark"}, "marked"),
        ("mark", {"episode_id": TAKE, "label": "success"}, "success"),
        ("disk-low", {"minutes_left": 8.37}, "disk low, 8.4 minutes left"),
        ("estop", {"reason": "ada"}, "emergency stop"),
        ("controller-fault", {"reason": "HALT, event 1010; clear it"}, "the controller stopped: HALT, event 1010"),
        ("server-died", {"server": "g1", "reason": "was killed"}, "g1 died"),
        ("server-crashed", {"reason": "ValueError"}, "teleop died"),
        ("gate", {"from": "tracking", "to": "holding", "reason": "command 0.12 s old"},
         "the robot holds: command 0.12 s old"),
        ("gate", {"from": "waiting", "to": "entering"}, ""),
        ("motion-loop", {"loops": 3}, ""),
    ],
)  # fmt: skip
def test_an_event_is_told_in_a_few_words_with_its_numbers(name: str, detail: dict[str, Any], said: str) -> None:
    assert words(name, **detail) == said


def test_what_ends_driving_and_what_stops_are_urgent_and_what_an_operator_does_is_not() -> None:
    for name, detail in (
        ("estop", {}),
        ("operator-lost", {"device": "pico"}),
        ("operator-disengaged", {"reason": "x"}),
    ):
        assert (cue := told(name, **detail)) is not None
        assert cue.is_urgent
    for name, detail in (("operator-engaged", {}), ("operator-disengaged", {"reason": "released"}), ("mark", {})):
        assert (cue := told(name, **detail)) is not None
        assert not cue.is_urgent


@example(reason="", label=":-x")
@given(reason=st.text(max_size=300), label=st.text(max_size=50))
def test_no_text_of_others_becomes_an_option_a_tag_or_a_speech(reason: str, label: str) -> None:
    table = Phrases({"mark": Phrase(words="{label}")})
    for said in (words("operator-refused", reason=reason), words("mark", table, label=label)):
        assert not said.startswith("-")
        assert said.isprintable()
        assert not set(said) & set('<>[]{}\\|&;$`"\n\0')
        assert len(said.split()) <= LONGEST_WORDS


def test_a_file_of_the_lab_changes_words_and_more(tmp_path: Path) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text(
        "operator-engaged: los\n"
        "operator-mode: none\n"
        'lab-door: {words: "door {door} is open", tune: alarm, urgent: true, about: door}\n'
        "gate to=entering: the robot begins\n"
        "estop: {words: halt}\n"
    )
    table = load(file)
    assert words("operator-engaged", table) == "los"
    assert words("operator-mode", table, mode="walk") == ""
    assert told("lab-door", table, door=2) == Cue(words="door 2 is open", tune="alarm", is_urgent=True, about="door")
    assert words("gate", table, to="entering") == "the robot begins"
    assert told("estop", table) == Cue(words="halt", tune="alarm", is_urgent=True, about="stop"), "the rest is kept"
    assert words("operator-refused", table, reason="no") == "refused: no", "and so are all others"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("estop: {wrods: halt}", r"estop: unknown key 'wrods' \(did you mean 'words'\?\)"),
        ("estop: {words: halt, tune: horn}", "tune: expected .*alarm.*got 'horn'"),
        ("estop: [halt]", r"estop: expected words, a mapping or none, got \['halt'\]"),
        ("gate to: holds", "'gate to': expected the name of an event, or name field=value"),
        ("- estop", "expected a mapping"),
    ],
)
def test_a_mistake_in_the_file_is_one_line(tmp_path: Path, text: str, complaint: str) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=complaint) as caught:
        load(file)
    assert "\n" not in str(caught.value)
    assert str(file) in str(caught.value)


def test_a_file_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(BadFile, match=r"none\.yaml: no such file"):
        load(tmp_path / "none.yaml")
