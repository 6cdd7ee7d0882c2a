"""Asking the recorder for something, from another process, and waiting for its answer."""

from __future__ import annotations

from typing import Any

from station.bus import keys
from station.bus.client import Bus
from station.episode.storage.request import Action, RecordAnswer, RecordRequest, parse_answer
from station.errors import NotReady, Refused
from station.life import request
from station.life.server import read_health


def ask(bus: Bus, action: Action, *, timeout_s: float = 20.0, **fields: Any) -> RecordAnswer:
    """Send a request and wait for its answer; a bus that is cut or restarted meanwhile is told again.

    Args:
        bus: The bus that the recorder listens on.
        action: What to do.
        timeout_s: Longest wait [s]; a stop waits for the disk.
        fields: The other fields of `RecordRequest`.

    Raises:
        NotReady: the bus did not take the request, or no answer came in time.
        Refused: the recorder said no; with its reason.
    """
    wanted = RecordRequest(id=request.new_id(), action=action, **fields)
    what = f"record {action}"
    with bus.watch([keys.RECORD_ACK]) as watch:
        answers = {keys.RECORD_ACK: lambda data: parse_answer(data, wanted.id)}
        found = request.ask(  # the recorder misses no write of a bus that is there
            bus, watch, keys.RECORD, wanted, answers, what=what, within_s=timeout_s, is_repeated=False
        )
    if not found:
        raise NotReady(f"{what}: {_why_silent(bus, timeout_s)}")
    answer = found[keys.RECORD_ACK]
    if not answer.ok:
        raise Refused(f"{what}: {answer.reason}")
    return answer


def _why_silent(bus: Bus, waited_s: float) -> str:
    for health in read_health(bus):
        if health.role == "recorder" and health.is_alive:
            return (
                f"{health.name!r} has not answered within {waited_s:g} s and is alive: its disk may hang, or others "
                "leave it no processor; it does what it was asked as soon as it can (`station status`)"
            )
    return f"no recorder answered within {waited_s:g} s; start one with `station serve recorder`"
