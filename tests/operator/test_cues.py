"""What waits to be heard, and who says it."""

from __future__ import annotations

import subprocess
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from station.operator.cues import MOST_WAITING, OLD_S, REPEAT_S, CueQueue, Speaker
from station.operator.device import DeviceError
from station.operator.voice import Cue, Hush
from tests.waiting import wait_until


def cue(words: str, about: str = "", *, urgent: bool = False) -> Cue:
    return Cue(words=words, about=about, is_urgent=urgent)


def taken(queue: CueQueue, now_s: float = 0.0) -> list[str]:
    found = []
    while (one := queue.pop(now_s)) is not None:
        found.append(one.words)
    return found


def test_cues_come_in_order_and_urgent_ones_first() -> None:
    queue = CueQueue()
    for one in (cue("a"), cue("stop", urgent=True), cue("b"), cue("lost", urgent=True)):
        queue.put(one, 0.0)
    assert taken(queue) == ["stop", "lost", "a", "b"]
    assert queue.dropped == 0


def test_of_what_is_about_the_same_only_the_newest_waits() -> None:
    queue = CueQueue()
    for words in ("engaged", "released", "engaged"):
        queue.put(cue(words, "driving"), 0.0)
    queue.put(cue("marked"), 0.0)
    assert taken(queue) == ["engaged", "marked"]
    assert queue.dropped == 2


def test_the_same_news_of_two_servers_is_told_once_and_again_when_it_happens_again() -> None:
    queue = CueQueue()
    assert queue.put(cue("emergency stop", "stop", urgent=True), 0.0)
    assert taken(queue) == ["emergency stop"]
    assert not queue.put(cue("emergency stop", "stop", urgent=True), 0.5)
    assert taken(queue, 0.5) == []
    assert queue.dropped == 0, "nothing was lost"
    assert queue.put(cue("stop released", "stop"), 0.6)
    assert queue.put(cue("emergency stop", "stop", urgent=True), 0.7), "it was released in between"
    assert queue.put(cue("emergency stop", "stop", urgent=True), 0.8 + REPEAT_S)
    assert queue.put(cue("marked"), 1.0)
    assert queue.put(cue("marked"), 1.1), "each mark is one of its own"


def test_what_has_waited_too_long_is_dropped_and_counted() -> None:
    queue = CueQueue()
    queue.put(cue("old"), 0.0)
    queue.put(cue("new"), 1.0)
    assert taken(queue, OLD_S + 0.5) == ["new"]
    assert queue.dropped == 1


@given(st.lists(st.tuples(st.sampled_from("abcdefgh"), st.sampled_from(["", "x", "y"]), st.booleans()), max_size=40))
def test_the_queue_is_bounded_and_every_cue_is_taken_or_counted(puts: list[tuple[str, str, bool]]) -> None:
    queue = CueQueue()
    put = 0
    for words, about, urgent in puts:
        put += queue.put(cue(words, about, urgent=urgent), 0.0)
        assert len(queue) <= MOST_WAITING
    newest_urgent = next((words for words, _, urgent in reversed(puts) if urgent), None)
    waiting_urgent = [one.words for _, one in queue._waiting if one.is_urgent]
    found = taken(queue)
    assert len(found) + queue.dropped == put
    assert found[: len(waiting_urgent)] == waiting_urgent
    if newest_urgent is not None and all(urgent for _, _, urgent in puts):
        assert newest_urgent in found


class Slow:
    """A voice that takes for ever for each cue unless it is hushed or let on."""

    def __init__(self, *, fails: Exception | None = None) -> None:
        self.began: list[str] = []
        self.ended: list[str] = []
        self.on = threading.Event()
        self.is_closed = False
        self.fails = fails

    def play(self, cue: Cue, hush: Hush) -> None:
        self.began.append(cue.words)
        while not self.on.is_set():
            if hush(0.01):
                return
        if self.fails is not None:
            raise self.fails
        self.ended.append(cue.words)

    def close(self) -> None:
        self.is_closed = True


def test_an_urgent_cue_breaks_off_what_is_being_said_but_no_urgent_one() -> None:
    voice = Slow()
    speaker = Speaker(voice)
    speaker.play(cue("recording take 7"))
    wait_until(lambda: voice.began == ["recording take 7"])
    speaker.play(cue("marked"))
    speaker.play(cue("emergency stop", urgent=True))
    wait_until(lambda: voice.began == ["recording take 7", "emergency stop"])
    speaker.play(cue("pico lost", urgent=True))
    assert (speaker.broken_off, voice.ended) == (1, [])
    voice.on.set()
    wait_until(lambda: speaker.is_idle)
    assert voice.ended == ["emergency stop", "pico lost", "marked"]
    speaker.close()
    assert voice.is_closed


def test_a_thousand_cues_to_a_voice_that_hangs_hold_nobody_up_and_are_counted() -> None:
    voice = Slow()
    speaker = Speaker(voice)
    speaker.play(cue("first"))
    wait_until(lambda: voice.began)
    for number in range(1000):
        speaker.play(cue(f"{number}"))
    assert speaker.dropped == 1000 - MOST_WAITING
    speaker.close()
    assert voice.is_closed
    assert voice.ended == []


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        (DeviceError("no card"), "no card"),
        (RuntimeError("mixer not\ninitialized"), "internal error in the voice: RuntimeError: mixer not initialized"),
        (subprocess.TimeoutExpired(["spd-say", "--cancel"], 1.0), "internal error in the voice: TimeoutExpired: "
         "Command '['spd-say', '--cancel']' timed out after 1.0 seconds"),
    ],
)  # fmt: skip
def test_a_voice_that_fails_however_it_fails_is_tried_again_with_the_next_cue(fault: Exception, told: str) -> None:
    voice = Slow(fails=fault)
    voice.on.set()
    speaker = Speaker(voice)
    assert (spoken(speaker, "one"), spoken(speaker, "two")) == (told, ""), "what lasts is told once"
    voice.fails = None
    assert (spoken(speaker, "three"), voice.ended) == ("", ["three"])
    voice.fails = fault
    assert spoken(speaker, "four") == told
    speaker.close()
    assert voice.is_closed


def spoken(speaker: Speaker, words: str) -> str:
    """Have something said to its end; return why it could not be."""
    speaker.play(cue(words))
    wait_until(lambda: speaker.is_idle)
    return speaker.pop_error()
