"""Each request is answered once, and again when it comes again."""

from __future__ import annotations

from station.episode.recorder.controller import Answers
from station.episode.storage.request import RecordAnswer

DONE = RecordAnswer(id="1", ok=True)


def test_an_answer_is_published_once_and_again_when_its_request_comes_again() -> None:
    answers = Answers()
    assert answers.is_new("1")
    answers.give(DONE)
    assert (answers.next(), answers.next()) == (DONE, None)
    assert not answers.is_new("1")
    assert answers.pop() == [DONE]


def test_a_request_that_is_still_worked_on_gets_no_second_answer() -> None:
    answers = Answers()
    assert answers.is_new("1")
    assert not answers.is_new("1")
    assert answers.next() is None


def test_answers_come_in_the_order_in_which_they_were_given() -> None:
    answers = Answers()
    others = [RecordAnswer(id=str(number), ok=False) for number in range(3)]
    for one in others:
        answers.give(one)
    assert answers.pop() == others
