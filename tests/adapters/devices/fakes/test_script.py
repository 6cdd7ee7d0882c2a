"""Scripts of fake devices: what is refused in one line, and that playing depends on the clock alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from adapters.devices.fakes.script import Play, Script, Step, load
from station.errors import BadFile
from tests.adapters.devices.by_hand import HandClock


class Spoken(Step, frozen=True, kw_only=True, forbid_unknown_fields=True):
    word: str = ""


def times(play: Play[Spoken], until_s: float) -> list[tuple[float, str]]:
    return [(round(at_s, 6), step.word) for at_s, step in play.due(until_s)]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "expected a script of a fake parrot"),
        ('{"device": "dog", "steps": []}', "is a script of a fake 'dog'; expected one of 'parrot'"),
        ('{"device": "parrot", "steps": []}', "has no steps"),
        ('{"device": "parrot", "steps": [{"word": "hi"}]}', "step 0: Object missing required field `at_s`"),
        ('{"device": "parrot", "steps": [{"at_s": 0, "bark": 1}]}', "a step may say at_s, word"),
        ('{"device": "parrot", "steps": [{"at_s": 2}, {"at_s": 1}]}', "step 1: at_s is 1, after 2; expected times in"),
        ('{"device": "parrot", "steps": [{"at_s": -1}]}', "step 0: at_s is -1"),
        ('{"device": "parrot", "steps": [{"at_s": 2}], "period_s": 1}', "expected more than 2 s"),
        ('{"device": "parrot", "steps": [{"at_s": 2}], "perod_s": 1}', "unknown field `perod_s`"),
    ],
)
def test_a_bad_script_is_one_line_that_says_what_is_wrong(tmp_path: Path, text: str, told: str) -> None:
    file = tmp_path / "script.json"
    file.write_text(text)
    with pytest.raises(BadFile) as caught:
        load(file, "parrot", Spoken)
    message = str(caught.value)
    assert told in message
    assert message.startswith(str(file))
    assert "\n" not in message


def test_a_missing_script_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(BadFile, match=r"cannot be read: No such file"):
        load(tmp_path / "none.json", "parrot", Spoken)


def test_each_step_is_due_once_and_repeats_come_a_period_later() -> None:
    script = Script((Spoken(at_s=0.0, word="a"), Spoken(at_s=0.5, word="b")), period_s=1.0)
    play = Play(script)
    assert times(play, 0.4) == [(0.0, "a")]
    assert times(play, 0.4) == []
    assert times(play, 2.0) == [(0.5, "b"), (1.0, "a"), (1.5, "b"), (2.0, "a")]


def test_the_clock_of_a_script_starts_with_the_first_look() -> None:
    clock = HandClock()
    play = Play(Script((Spoken(at_s=1.0),)), clock)
    clock.pass_(60.0)
    assert not play.has_begun
    assert play.time_s() == 0.0
    clock.pass_(0.75)
    assert play.time_s() == pytest.approx(0.75)
