"""Asking the recorder for something, from another process, and waiting for its answer."""

from __future__ import annotations

import secrets
from typing import Any

from station.bus import codec, keys
from station.bus.client import Bus
from station.episode.storage.request import Action, RecordAnswer, RecordRequest, parse_answer
from station.errors import NotReady, Refused

_LOOK_S = 0.2  # how soon a request is sent again to a bus that was restarted and forgot it


def ask(bus: Bus, action: Action, *, timeout_s: float = 20.0, **fields: Any) -> RecordAnswer:
    """Send a request and wait for its answer; a bus that is cut or restarted meanwhile is told again.

    Args:
        bus: The bus that the recorder listens on.
        action: What to do.
        timeout_s: Longest wait [s]; a stop waits for the disk.
        fields: The other fields of `RecordRequest`.

    Raises:
        NotReady: the bus did not take the request, or no recorder answered.
        Refused: the recorder said no; with its reason.
    """
    wanted = RecordRequest(id=secrets.token_hex(6), action=action, **fields)
    request, sent_on = {keys.RECORD: codec.json_object(wanted)}, 0
    deadline = bus.clock.monotonic_s() + timeout_s
    with bus.watch([keys.RECORD_ACK]) as watch:
        newest = None
        while (remaining := deadline - bus.clock.monotonic_s()) > 0:
            if watch.connections != sent_on:  # its id keeps it from being done twice
                if bus.publish(request):
                    sent_on = watch.connections
                elif bus.is_connected:
                    raise NotReady(f"record {action}: the bus {bus.address} did not take the request: {bus.last_error}")
            sample = watch.wait(keys.RECORD_ACK, after=newest, timeout_s=min(remaining, _LOOK_S))
            sample = sample or watch.latest(keys.RECORD_ACK)  # came while nobody told us: without age, yet with our id
            if sample is not None and (answer := parse_answer(sample.value, wanted.id)) is not None:
                return _accepted(action, answer)
            newest = sample or newest
    if not sent_on:
        raise NotReady(f"record {action}: the bus {bus.address} has been gone for {timeout_s:g} s: {bus.last_error}")
    raise NotReady(
        f"record {action}: no recorder answered within {timeout_s:g} s; start one with `station serve recorder`"
    )


def _accepted(action: Action, answer: RecordAnswer) -> RecordAnswer:
    if not answer.ok:
        raise Refused(f"record {action}: {answer.reason}")
    return answer
