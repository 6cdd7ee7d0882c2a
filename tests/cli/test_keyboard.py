"""The terminal's keys without a terminal; with one they are tried in test_up_keys.py."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from station.cli import keyboard as keyboard_module
from station.cli.keyboard import Keyboard, keys_of


def keyboard(show: Callable[[str], None] = lambda text: None) -> tuple[Keyboard, list[str]]:
    """A keyboard whose SPACE acts at once, and the keys that it gave away."""
    taken: list[str] = []

    def take(key: str) -> bool:
        taken.append(key)
        return True

    return Keyboard(lambda key, is_typing: key == " ", take, lambda: None, show), taken


def test_who_answers_at_the_moment_that_the_question_is_shown_is_heard() -> None:
    def show(text: str) -> None:
        for key in "y\r" if text == "Go? " else "":
            keys.press(key)

    keys, taken = keyboard(show)
    assert keys.ask("Go? ", threading.Event()) == "y"
    assert taken == []


def test_what_was_typed_before_a_question_is_no_answer_to_it() -> None:
    keys, taken = keyboard()
    for key in "y\r":
        keys.press(key)
    assert keys.ask("Go? ", threading.Event()) == ""
    assert taken == ["y", "\r"]


def test_a_question_that_was_answered_elsewhere_ends_and_the_enter_that_was_on_its_way_is_nobodys_key(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def show(text: str) -> None:
        if text == "Go? ":
            keys.press("y")

    keys, taken = keyboard(show)
    assert keys.ask("Go? ", threading.Event(), lambda: True) == ""
    keys.press("\r")
    assert taken == []
    monkeypatch.setattr(keyboard_module, "_DEAF_S", 0.0)
    assert keys.ask("Go? ", threading.Event(), lambda: True) == ""
    keys.press("\r")
    assert taken == ["\r"], "the next key is one again"


@pytest.mark.parametrize(
    ("sent", "keys"),
    [
        (b"\x1b[A w", ["\x1b[A", " ", "w"]),  # an arrow that repeats does not swallow the stop behind it
        (b"w\x1b[1;5C\x1bOP\x1b[15~ ", ["w", "\x1b[1;5C", "\x1bOP", "\x1b[15~", " "]),
        (b"\x1b", ["\x1b"]),
        (b"\x1b ", ["\x1b", " "]),  # Alt with SPACE
        (b"\xff\n ", ["\ufffd", "\n", " "]),
    ],
)
def test_what_a_terminal_sends_at_once_is_told_apart(sent: bytes, keys: list[str]) -> None:
    assert keys_of(sent) == keys
