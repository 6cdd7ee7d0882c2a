"""What the runbook of a station is doing, on ``station:runbook``; and answering its question, from anywhere.

An answer is a request (`station.life.request`): JSON on ``station:runbook:answer``, which its asker writes again until
it finds in ``station:runbook`` what came of it. The terminal of `station up` may answer as well: whoever is first wins.
"""

from __future__ import annotations

import getpass
from typing import Annotated, Literal

import msgspec

from station.bus import clocks, codec, keys
from station.bus.client import Bus
from station.bus.sample import Sample
from station.bus.stamp import boot_of
from station.errors import NotReady, Refused
from station.life import request
from station.life.request import LateS
from station.life.server import DEAD_AFTER_S

WITHIN_S = 3.0
"""Longest wait for what came of an answer [s]; a station that is there says it at once."""

HOLD_S = 1.2
"""So long a finger stays on an answer before it counts, where people stand beside a real robot [s]."""

StepState = Literal["todo", "now", "done", "failed"]
Word = Annotated[str, msgspec.Meta(max_length=64)]


class StepStatus(msgspec.Struct, frozen=True, kw_only=True):
    """One step, as a person reads it, and what came of it."""

    text: str
    state: StepState = "todo"
    result: str = ""


class Question(msgspec.Struct, frozen=True, kw_only=True):
    """What a person is asked now.

    Attributes:
        id: Each question has its own, also one that is asked again.
        sentence: What to look at.
        answers: The words that answer it.
        hold_s: How long a button is to be held until it counts as an answer [s]; 0 where no real robot is driven.
    """

    id: str
    sentence: str
    answers: tuple[str, ...]
    hold_s: float = 0.0


class AnswerResult(msgspec.Struct, frozen=True, kw_only=True):
    """What came of an answer, under the id of its request; `refused` says why it does not count, or is ""."""

    id: str
    refused: str = ""


class RunbookStatus(msgspec.Struct, frozen=True, kw_only=True):
    """What a runbook is doing.

    Attributes:
        name, robot: What it is called, and which robot it drives.
        robot_is_real: Whether people stand beside the robot.
        steps: All of them, in order.
        question: The one that is open, or None.
        results: What came of the newest answers that were written on the bus.
        is_over: Whether the station has ended.
    """

    name: str
    robot: str
    robot_is_real: bool
    steps: tuple[StepStatus, ...]
    question: Question | None = None
    results: tuple[AnswerResult, ...] = ()
    is_over: bool = False


class AnswerRequest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An answer.

    Attributes:
        question: Id of the question.
        answer: One of its words.
        who: Who answers, for the recording.
        where: From where: ``console``, ``script``, …
        id: Found again in what came of it.
        late_s: How long after it was first written this was [s].
    """

    question: Word
    answer: Word
    who: Word
    where: Word = "script"
    id: Word = ""
    late_s: LateS = 0.0


def status(bus: Bus) -> RunbookStatus | None:
    """Return what the runbook on a bus is doing; None where none is run, or its station was killed.

    Raises:
        BusError: the bus is lost.
    """
    sample = bus.read([keys.RUNBOOK]).get(keys.RUNBOOK)
    return None if sample is None else current(bus, sample)


def current(bus: Bus, sample: Sample) -> RunbookStatus | None:
    """Return what a value of ``station:runbook`` says; None where it is old, over or none.

    Raises:
        BusError: the bus is lost, and who wrote it is on another machine.
    """
    found, mark = decode_status(sample.value), sample.stamp
    if found is None or found.is_over or mark is None:
        return None
    if mark.is_from_this_boot:
        age_ns = bus.clock.monotonic_ns() - mark.mono_ns
    else:
        boot = boot_of(mark.source)
        age_ns = bus.clock.wall_ns() - mark.wall_ns + clocks.walls_ahead_ns(bus.call, [boot], bus.clock)[boot]
    return found if age_ns < DEAD_AFTER_S * 1e9 else None


def answer(bus: Bus, question: str, word: str, *, who: str = "", where: str = "script") -> None:
    """Answer the question that a runbook asks, and wait until that counts.

    Args:
        bus: The bus of the station.
        question: Id of the question.
        word: One of its answers.
        who: Who answers, for the recording; "" for this user's login name.
        where: From where.

    Raises:
        NotReady: no station runs a runbook there, the bus did not take the answer, or nothing came of it.
        Refused: it does not count, with the reason: another was first, the question is over, it has no such answer, or
            this user of the bus may not answer.
    """
    try:
        wanted = msgspec.convert(
            {"question": question, "answer": word, "who": who or getpass.getuser(), "where": where,
             "id": request.new_id()}, AnswerRequest,
        )  # fmt: skip
    except msgspec.ValidationError as error:
        raise Refused(f"runbook answer: {error}") from None
    if status(bus) is None:
        raise NotReady(f"no runbook is run on {bus.address}; `station up RUNBOOK` runs one")
    answers = {keys.RUNBOOK: lambda data: _result(data, wanted.id)}
    with bus.watch([keys.RUNBOOK]) as watch:
        try:
            found = request.ask(
                bus, watch, keys.RUNBOOK_ANSWER, wanted, answers, what="runbook answer", within_s=WITHIN_S
            )
        except NotReady as error:
            raise _refused(bus, error) from None
    if (result := found.get(keys.RUNBOOK)) is None:
        said = f"nothing came of it within {WITHIN_S:g} s ({bus.last_error or 'is its station frozen?'})"
        raise _refused(bus, NotReady(f"runbook answer: {said}"))
    if result.refused:
        raise Refused(f"runbook answer: {result.refused}")


def decode_status(data: bytes) -> RunbookStatus | None:
    """Return what bytes from the bus say of a runbook, or None when they say nothing."""
    try:
        return codec.parse_struct(data, RunbookStatus)
    except codec.BadValue:
        return None


def _result(data: bytes, asked: str) -> AnswerResult | None:
    found = decode_status(data)
    return None if found is None else next((result for result in found.results if result.id == asked), None)


def _refused(bus: Bus, error: NotReady) -> NotReady | Refused:
    if "NOPERM" not in str(error):
        return error
    user = bus.address.username or "default"
    return Refused(f"runbook answer: user {user!r} of the bus may not answer; expected operator or console")
