"""What a voice is: it lets an operator hear what happens. Knows no bus and no device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import msgspec

Tune = Literal["up", "down", "note", "no", "lost", "begin", "end", "alarm"]
"""What a cue sounds like to a voice without words: ``up`` the operator drives, ``down`` no longer; ``note`` something
changed; ``no`` it was refused; ``lost`` something is gone; ``begin`` and ``end`` of a recording; ``alarm`` a stop."""

Hush = Callable[[float], bool]
"""Waits for so long [s], and returns at once with True where the cue is to be broken off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cue:
    """Something to be heard.

    Attributes:
        words: What is said, on one line, without characters that would steer a program.
        tune: What it sounds like.
        is_urgent: Whether it breaks off what is being said, and goes before all that waits.
        about: Its subject: a newer cue about the same takes the place of one that waits. "" for none.
    """

    words: str
    tune: Tune = "note"
    is_urgent: bool = False
    about: str = ""


class Voice(Protocol):
    """Says cues, one after the other, for a thread of its own."""

    def play(self, cue: Cue, hush: Hush) -> None:
        """Play a cue to its end, or until `hush` says otherwise; `hush` is asked at least every tenth of a second.

        Raises:
            StationError: it could not be said; one line. The next cue is tried again.
        """
        ...

    def close(self) -> None:
        """Release what it speaks through; nothing is being said then."""
        ...


class VoiceKind(msgspec.Struct, frozen=True, kw_only=True):
    """What a module registers under ``station.voices``; imports nothing heavy.

    Attributes:
        name: Name under which it is found.
        about: What it is, in a line.
        options: Type of its options.
        missing: Says in a line what this machine lacks for it and what to do; "" for nothing.
        make: Makes a voice of options; raises a `station.errors.StationError` that says what is missing.
    """

    name: str
    about: str
    options: type[msgspec.Struct]
    missing: Callable[[], str]
    make: Callable[[Any], Voice]
