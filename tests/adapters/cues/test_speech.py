"""Speech by programs, which are fakes that note their arguments."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from adapters.cues.speech import Speech, SpeechOptions, missing
from station.operator.device import DeviceError
from station.operator.voice import Cue
from tests.adapters.cues.programs import calls, put
from tests.waiting import DEADLINE_S

pytestmark = pytest.mark.usefixtures("processes")

NEVER = threading.Event().wait
TAKE = Cue(words="recording take 7")
FOR_EVER = "while True: time.sleep(0.1)"


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only folder on the path."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    return folder


@pytest.mark.parametrize(
    ("program", "arguments"),
    [
        ("espeak-ng", ["-v", "en-us", "-s", "200", "--", TAKE.words]),
        ("espeak", ["-v", "en-us", "-s", "200", "--", TAKE.words]),
        ("spd-say", ["-l", "en-us", "--rate", "25", "--wait", "--", TAKE.words]),
        ("say", ["-v", "en-us", "-r", "200", TAKE.words]),
    ],
)
def test_each_program_is_called_in_its_own_way(path: Path, program: str, arguments: list[str]) -> None:
    log = put(path, program)
    voice = Speech(SpeechOptions(voice="en-us", words_per_minute=200))
    voice.play(TAKE, NEVER)
    assert voice.program == program
    assert calls(log) == [arguments]


def test_words_are_one_argument_whatever_is_in_them(path: Path) -> None:
    log = put(path, "espeak-ng")
    Speech(SpeechOptions()).play(Cue(words="a; touch /tmp/x $(id) `id` && b"), NEVER)
    assert calls(log)[0][-1] == "a; touch /tmp/x $(id) `id` && b"


@pytest.mark.parametrize("program", ["espeak-ng", "spd-say"])
def test_a_cue_that_is_broken_off_ends_its_program(path: Path, program: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("adapters.cues.speech._ENDS_S", DEADLINE_S)
    then = f'if "--cancel" not in sys.argv:\n    {FOR_EVER}'
    log = put(path, program, then=then)
    voice = Speech(SpeechOptions())
    voice.play(TAKE, lambda wait_s: NEVER(wait_s) or bool(calls(log)))
    assert calls(log)[1:] == ([["--cancel"]] if program == "spd-say" else [])


def test_a_program_that_fails_is_told_with_its_last_words(path: Path) -> None:
    put(path, "espeak-ng", then='sys.exit("no such voice\\n\\n")')
    with pytest.raises(DeviceError, match=r"^espeak-ng ended with exit code 1: no such voice$"):
        Speech(SpeechOptions()).play(TAKE, NEVER)


def test_a_program_that_does_not_let_itself_be_broken_off_is_told(path: Path) -> None:
    log = put(path, "spd-say", then=FOR_EVER)
    with pytest.raises(DeviceError, match=r"^`spd-say --cancel` has not ended within 1 s; does its sound service run"):
        Speech(SpeechOptions()).play(TAKE, lambda wait_s: NEVER(wait_s) or bool(calls(log)))


def test_a_program_that_vanishes_is_told(path: Path) -> None:
    put(path, "espeak-ng")
    voice = Speech(SpeechOptions())
    (path / "espeak-ng").unlink()
    with pytest.raises(DeviceError, match="cannot be run: No such file or directory"):
        voice.play(TAKE, NEVER)


def test_a_machine_without_any_says_what_to_install(path: Path) -> None:
    assert missing().startswith(
        "no program to speak with: none of espeak-ng, espeak, spd-say, say on the path; install one"
    )
    put(path, "say")
    assert missing() == ""
    with pytest.raises(DeviceError, match="no espeak-ng on the path"):
        Speech(SpeechOptions(program="espeak-ng"))
