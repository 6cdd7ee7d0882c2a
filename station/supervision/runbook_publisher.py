"""Says on the bus what a runbook is doing, and takes answers to its question there (`station.life.runbook_request`).

Of the terminal and all who answer on the bus, whoever is first wins; the others are told. One station at a time has
``station:runbook``: another on the same bus says nothing there until that one has ended, or was silent for 2 s.
"""

from __future__ import annotations

import contextlib
import getpass
import logging
import threading
from collections import deque
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import NamedTuple

import msgspec

from station.bus import codec, keys
from station.bus.client import Bus
from station.clock import Thread
from station.errors import BusError, Refused, did_you_mean
from station.life import request, runbook_request
from station.life.request import NewRequests
from station.life.runbook_request import (
    HOLD_S,
    AnswerRequest,
    AnswerResult,
    Question,
    RunbookStatus,
    StepState,
    StepStatus,
)
from station.life.server import HEARTBEAT_S
from station.printable import printable
from station.supervision.runbook import Runbook

log = logging.getLogger(__name__)

TERMINAL = "terminal"

_LOOK_S = 0.05
_REMEMBERED = 16  # results: an asker looks for its own within half a second


class GivenAnswer(NamedTuple):
    """An answer that counts."""

    answer: str
    who: str
    where: str

    def __str__(self) -> str:
        return f"{self.answer}, by {self.who} ({self.where})"


class RunbookPublisher:
    """A context manager, which says at its end that the runbook is over.

    Args:
        bus: The station's.
        runbook: What it does.
    """

    def __init__(self, bus: Bus, runbook: Runbook) -> None:
        self._bus, self._clock = bus, bus.clock
        self._hold_s = HOLD_S if runbook.robot_is_real else 0.0
        self._status = RunbookStatus(
            name=runbook.name, robot=runbook.robot, robot_is_real=runbook.robot_is_real,
            steps=tuple(StepStatus(text=str(step)) for step in runbook.steps),
        )  # fmt: skip
        self._given: GivenAnswer | None = None
        self._last = ("", "")  # id of the question that was closed last, and how
        self._why_not: Callable[[], str] = lambda: ""
        self._results: deque[AnswerResult] = deque(maxlen=_REMEMBERED)
        self._lock = self._clock.lock()  # around the question and its answer
        self._publishing = self._clock.lock()  # an older status is never written over a newer one
        self._ended = threading.Event()
        self._thread: Thread | None = None

    def __enter__(self) -> RunbookPublisher:
        self._watch = self._bus.watch([keys.RUNBOOK, keys.RUNBOOK_ANSWER])
        self._requests = NewRequests(self._watch, keys.RUNBOOK_ANSWER)
        self._publish()
        self._thread = self._clock.start(self._run, "runbook")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        if self._thread is not None:
            self._clock.join(self._thread)
        self._change(question=None, is_over=True)
        self._watch.close()

    def step(self, number: int, state: StepState, result: str = "") -> None:
        """Say how far a step is, by its place in the runbook, from 0."""
        steps = list(self._status.steps)
        steps[number] = msgspec.structs.replace(steps[number], state=state, result=result)
        self._change(steps=tuple(steps))

    def ask(
        self, sentence: str, answers: Sequence[str], prompt: Callable[[Callable[[], bool]], str]
    ) -> GivenAnswer | None:
        """Ask here and on the bus; return the answer that came first, or None where nobody gives one.

        Args:
            sentence: What to look at.
            answers: The words that answer it.
            prompt: Asks the person at the terminal, and returns one of the words or ""; ends when what it is given
                returns True, since the question was answered elsewhere.
        """
        self._open(sentence, answers, lambda: "")
        word = ""
        try:
            word = prompt(lambda: self._given is not None)
        finally:
            given = self._close(GivenAnswer(word, getpass.getuser(), TERMINAL) if word else None)
        return given

    def offer(self, sentence: str, answer: str, why_not: Callable[[], str]) -> None:
        """Keep a question open beside what is done, or no more where the sentence is "".

        Args:
            sentence: What to look at.
            answer: The word that takes the offer.
            why_not: Why it cannot be taken now, or "".
        """
        if sentence:
            self._open(sentence, (answer,), why_not)
        else:
            self._close(None)

    def pop_taken(self, typed: GivenAnswer | None) -> GivenAnswer | None:
        """Return who has taken the offer since the last call: on the bus, else at the terminal, as was `typed`."""
        return None if self._given is None and typed is None else self._close(typed)

    def _open(self, sentence: str, answers: Sequence[str], why_not: Callable[[], str]) -> None:
        asked = Question(id=request.new_id(), sentence=sentence, answers=tuple(answers), hold_s=self._hold_s)
        with self._lock:
            self._given, self._why_not = None, why_not
            self._status = msgspec.structs.replace(self._status, question=asked)
        self._publish()

    def _close(self, own: GivenAnswer | None) -> GivenAnswer | None:
        """Close the question; return the answer that came first, which may be our own."""
        with self._lock:
            given = self._given or own
            if (asked := self._status.question) is None:
                return own
            self._last = asked.id, f"answered: {given}" if given is not None else "taken back"
            self._given = None
            self._status = msgspec.structs.replace(self._status, question=None)
        self._publish()
        return given

    def _run(self) -> None:
        newest, said_s, connections = None, self._clock.monotonic_s(), self._watch.connections
        while not self._ended.is_set():
            newest = self._watch.wait(keys.RUNBOOK_ANSWER, after=newest, timeout_s=_LOOK_S) or newest
            has_answered = self._answer_requests()
            now_s, connected = self._clock.monotonic_s(), self._watch.connections
            if has_answered or now_s - said_s >= HEARTBEAT_S or connected != connections:
                said_s = now_s
                if self._publish():  # our own line may not be back yet
                    connections = connected

    def _answer_requests(self) -> bool:
        """Take up what was written since the last call; return whether that was an answer."""
        if (asked := self._requests.pop()) is None or self._has_another():
            return False
        try:
            wanted = request.parse(asked.data, AnswerRequest, "an answer to a runbook's question")
        except Refused as error:
            log.debug("%s: %s", keys.RUNBOOK_ANSWER, error)  # whoever wrote it waits for nothing: it has no id
            return False
        if wanted.id and any(result.id == wanted.id for result in self._results):
            return True  # written again: what came of it was overwritten before its asker saw it
        refused = self._refuse_or_take(wanted)
        if wanted.id:
            self._results.append(AnswerResult(id=wanted.id, refused=refused))
        return True

    def _refuse_or_take(self, wanted: AnswerRequest) -> str:
        """Take an answer and return "", or return why it does not count."""
        if why_not := self._why_not():
            return why_not
        with self._lock:
            asked = self._status.question
            if asked is None or wanted.question != asked.id:
                became = self._last[1] if wanted.question == self._last[0] else "not open"
                return f"question {wanted.question!r}: {became}; open now: {asked.id if asked else 'none'}"
            if self._given is not None:
                return f"question {asked.id!r}: answered: {self._given}"
            if wanted.answer not in asked.answers:
                hint = did_you_mean(wanted.answer, asked.answers)
                return f"unknown answer {wanted.answer!r}{hint}; expected one of {', '.join(asked.answers)}"
            if not wanted.who.strip():
                return "who: expected who answers, got nothing"
            self._given = GivenAnswer(wanted.answer, printable(wanted.who), printable(wanted.where))
            return ""

    def _has_another(self) -> bool:
        """Whether the key is that of another station, which lives."""
        sample = self._watch.latest(keys.RUNBOOK)
        if sample is None or sample.stamp is None or sample.stamp.source == self._bus.source:
            return False
        with contextlib.suppress(BusError):
            return runbook_request.current(self._bus, sample) is not None
        return False

    def _change(self, **fields: object) -> None:
        with self._lock:
            self._status = msgspec.structs.replace(self._status, **fields)
        self._publish()

    def _publish(self) -> bool:
        """Say all; return whether that is said, or not ours to say."""
        with self._publishing:
            said = msgspec.structs.replace(self._status, results=tuple(self._results))
            return self._has_another() or self._bus.publish({keys.RUNBOOK: codec.json_object(said)})
