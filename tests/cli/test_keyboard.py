"""The terminal's keys without a terminal; with one they are tried in test_up_keys.py."""

from __future__ import annotations

import threading

from station.cli.keyboard import Keyboard


def test_who_answers_at_the_moment_that_the_question_is_shown_is_heard() -> None:
    def show(text: str) -> None:
        for key in "y\r" if text == "Go? " else "":
            keyboard.press(key)

    keyboard = Keyboard(lambda key, is_typing: False, lambda: None, show)
    assert keyboard.ask("Go? ", threading.Event()) == "y"


def test_what_was_typed_before_a_question_is_no_answer_to_it() -> None:
    keyboard = Keyboard(lambda key, is_typing: False, lambda: None, lambda text: None)
    for key in "y\r":
        keyboard.press(key)
    assert keyboard.ask("Go? ", threading.Event()) == ""
    assert [keyboard.pop(), keyboard.pop()] == ["y", "\r"]
