"""Answers on their way to those who asked, each request answered once however often it is sent."""

from __future__ import annotations

from collections import deque

from station.episode.storage.request import RecordAnswer

_REMEMBERED = 64
_MOST_DUE = 256  # of a flood of requests the newest are answered: whoever sent the others has stopped waiting


class Answers:
    """Queue of answers, with a memory of the newest requests."""

    def __init__(self) -> None:
        self._due: deque[RecordAnswer] = deque(maxlen=_MOST_DUE)
        self._known: dict[str, RecordAnswer | None] = {}

    def is_new(self, asker: str | None) -> bool:
        """Whether a request was not seen before; one whose answer may have been lost gets it again."""
        if asker is None:
            return True
        if asker not in self._known:
            self._remember(asker, None)
            return True
        answer = self._known[asker]
        if answer is not None:
            self._due.append(answer)
        return False

    def knows(self, asker: str | None) -> bool:
        """Whether a request was seen before."""
        return asker in self._known

    def remember(self, asker: str, answer: RecordAnswer | None = None) -> None:
        """Count a request as seen, and answered so should it come again; None leaves it without an answer."""
        self._remember(asker, answer)

    def give(self, answer: RecordAnswer) -> None:
        """Have an answer published."""
        self._remember(answer.id, answer)
        self._due.append(answer)

    def next(self) -> RecordAnswer | None:
        """Return the oldest answer that is to be published, or None."""
        return self._due.popleft() if self._due else None

    def take(self) -> list[RecordAnswer]:
        """Return what is to be published, oldest first; it is then taken as published."""
        due = list(self._due)
        self._due.clear()
        return due

    def _remember(self, asker: str, answer: RecordAnswer | None) -> None:
        self._known[asker] = answer
        while len(self._known) > _REMEMBERED:
            del self._known[next(iter(self._known))]
