"""What an operator's page may ask of a station, each by the same call that a script would make."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from station.api.live import Station
from station.errors import UsageError
from station.web.stops import Stops

_LONGEST = 500  # characters


class Ask(msgspec.Struct, frozen=True, kw_only=True):
    """A request of a page; fields that `what` does not need are left out.

    Attributes:
        id: Found again in the answer.
        what: What is asked for, one of `ASKS`.
        robot: Name of the robot, or of its server.
        task, instruction, label, reason, success: As of `station.api.live.Record`.
        question, answer: Of a runbook.
    """

    id: str
    what: str
    robot: str = ""
    task: str = ""
    instruction: str = ""
    label: str = ""
    reason: str = ""
    success: bool | None = None
    question: str = ""
    answer: str = ""

    def __post_init__(self) -> None:
        """Refuse what no person wrote."""
        for field in self.__struct_fields__:
            value = getattr(self, field)
            if isinstance(value, str) and len(value) > _LONGEST:
                raise ValueError(f"{field}: expected at most {_LONGEST} characters, got {len(value)}")


def do(station: Station, stops: Stops, ask: Ask, who: str) -> str:
    """Do what is asked for; return what came of it, in words.

    Args:
        station: The station.
        stops: Of the pages.
        ask: What is asked for.
        who: Who asks, for the recording.

    Raises:
        UsageError: nothing of that name can be asked.
        StationError: it was refused, or nobody answered; with the reason.
    """
    act = ASKS.get(ask.what)
    if act is None:
        raise UsageError(f"{ask.what}: expected one of {', '.join(ASKS)}")
    return act(station, stops, ask, who)


def _start(station: Station, _stops: Stops, ask: Ask, who: str) -> str:
    answer = station.record.start(ask.task, instruction=ask.instruction)
    return f"recording {answer.episode_id}"


def _stop(station: Station, _stops: Stops, ask: Ask, _who: str) -> str:
    answer = station.record.stop(success=ask.success)
    return f"recorded {answer.episode_id}: {_counted(answer.summary)}"


def _mark(station: Station, _stops: Stops, ask: Ask, _who: str) -> str:
    station.record.mark(ask.label or "mark")
    return "marked"


def _discard(station: Station, _stops: Stops, ask: Ask, _who: str) -> str:
    answer = station.record.discard(ask.reason)
    return f"discarded {answer.episode_id}; nothing is deleted"


def _arm(station: Station, _stops: Stops, ask: Ask, who: str) -> str:
    return f"armed: {', '.join(station.arm(ask.robot, reason=f'{who}, console'))}"


def _disarm(station: Station, _stops: Stops, ask: Ask, who: str) -> str:
    return f"disarmed: {', '.join(station.disarm(ask.robot, reason=f'{who}, console'))}"


def _release(_station: Station, stops: Stops, _ask: Ask, who: str) -> str:
    stops.release(f"{who}, console")
    return "the stop is released"


def _answer(station: Station, _stops: Stops, ask: Ask, who: str) -> str:
    station.answer(ask.question, ask.answer, who=who[:64], where="console")
    return f"answered: {ask.answer}"


def _play(name: str) -> Callable[[Station, Stops, Ask, str], str]:
    def play(station: Station, _stops: Stops, _ask: Ask, _who: str) -> str:
        getattr(station.motion, name)()
        return f"motion: {name}"

    return play


def _counted(summary: Mapping[str, Any]) -> str:
    try:
        return f"{summary['seconds']:.1f} s, {summary['messages']} messages, {summary['lost']} lost"
    except (KeyError, TypeError, ValueError):
        return "finished"


ASKS: dict[str, Callable[[Station, Stops, Ask, str], str]] = {
    "record.start": _start,
    "record.stop": _stop,
    "record.mark": _mark,
    "record.discard": _discard,
    "arm": _arm,
    "disarm": _disarm,
    "release": _release,
    "runbook.answer": _answer,
    "motion.start": _play("start"),
    "motion.pause": _play("pause"),
    "motion.resume": _play("resume"),
}
"""What may be asked for, by its name."""
