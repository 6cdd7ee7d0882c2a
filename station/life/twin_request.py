"""Asking a robot twin for other faults: JSON on ``station:twin``, answered in the heartbeat of its server."""

from __future__ import annotations

import getpass
from collections.abc import Mapping
from typing import Any

import msgspec

from station.bus import codec, keys
from station.bus.client import Bus
from station.errors import NotReady, Refused
from station.life import request
from station.life.request import LateS
from station.life.server import Health, decode_health, read_health

WITHIN_S = 3.0
"""Longest wait for an answer [s]; a heartbeat comes twice a second."""

STATED_AS = "twin"
"""In what a twin's server states: which twin it runs."""


class TwinRequest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is asked for.

    Attributes:
        faults: Those to change, by name; what they mean is the twin's.
        is_well: Whether all others are switched off first.
        id: Found again in the answer.
        server: Name of the twin's server.
        who: For the recording.
        late_s: How long after it was first written this was [s].
    """

    faults: dict[str, Any] = {}
    is_well: bool = False
    id: str = ""
    server: str = ""
    who: str = ""
    late_s: LateS = 0.0


class TwinAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """What came of a request; `refused` says why nothing was changed, or is ""."""

    id: str
    refused: str = ""


def ask(
    bus: Bus, twin: str, faults: Mapping[str, Any], *, is_well: bool = False, within_s: float = WITHIN_S
) -> dict[str, Any]:
    """Have a twin that runs change its faults, and wait until it has; return what its heartbeat says then.

    Args:
        bus: The bus that its server runs on.
        twin: Registered name of the twin.
        faults, is_well: As in `TwinRequest`.
        within_s: Longest wait [s].

    Raises:
        NotReady: no such twin runs, the bus did not take the request, or no answer came.
        Refused: it does not know such a fault, or not such a value; with what it expects.
    """
    server = _server_of(bus, twin)
    wanted = TwinRequest(
        faults=dict(faults), is_well=is_well, id=request.new_id(), server=server, who=getpass.getuser()
    )
    place = keys.server(server)
    with bus.watch([place]) as watch:
        answers = {place: lambda data: _answer(data, wanted.id)}
        found = request.ask(bus, watch, keys.TWIN, wanted, answers, what="twin", within_s=within_s).get(place)
    if found is None:
        raise NotReady(f"{server}: no answer within {within_s:g} s; does it run? `station status` tells")
    answer, health = found
    if answer.refused:
        raise Refused(f"{server}: {answer.refused}")
    return health.detail


def _server_of(bus: Bus, twin: str) -> str:
    now_ns = bus.clock.wall_ns()
    for health in read_health(bus):
        stated = codec.parse_facts(bus.get(keys.server_config(health.name)) or b"")
        if stated.get(STATED_AS) == twin and health.is_alive_at(now_ns):
            return health.name
    raise NotReady(f"no twin {twin!r} runs on {bus.address}; start one with `station robot-twin {twin}`")


def _answer(data: bytes, asked: str) -> tuple[TwinAnswer, Health] | None:
    """Return the answer to a request that a heartbeat tells of, with that heartbeat, if it does."""
    health = decode_health(data)
    if health is None:
        return None
    try:
        answer = msgspec.convert(health.detail.get("changed"), TwinAnswer)
    except msgspec.ValidationError:
        return None
    return (answer, health) if answer.id == asked else None
