"""How a session shows itself and asks; the command line implements it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from station.life.events import Severity
from station.life.server import Health


class SessionUI(Protocol):
    """What a person sees and answers."""

    @property
    def is_attended(self) -> bool:
        """Whether a person is there to answer."""
        ...

    def begin(self, step: str) -> None:
        """A step begins."""
        ...

    def done(self, step: str, result: str) -> None:
        """A step is done."""
        ...

    def failed(self, step: str, reason: str) -> None:
        """A step has failed."""
        ...

    def report(self, text: str, severity: Severity = "info") -> None:
        """Something happened."""
        ...

    def confirm(self, sentence: str, is_answered: Callable[[], bool]) -> bool:
        """Ask a person; whether the answer was yes. Ends without one once it `is_answered` elsewhere."""
        ...

    def ask(self, question: str, answers: Sequence[str], is_answered: Callable[[], bool]) -> str:
        """Ask a person for one of some words; "" where nobody answers, and once it `is_answered` elsewhere."""
        ...

    def offer(self, restart: str) -> None:
        """Offer to start some servers again, by their names; "" takes the offer back."""
        ...

    def pop_restart(self) -> bool:
        """Whether a person has taken the offer since the last call."""
        ...

    def show(self, health: list[Health]) -> None:
        """How the servers are doing, a few times a second."""
        ...
