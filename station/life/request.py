"""A request to a server: JSON on a key, answered under the request's id in what that server publishes anyway.

A key holds one value at a time: a request may be overwritten before its server has seen it, and its answer before its
asker has. So an asker writes it again until it is answered, each time with how long ago it first did, and a server does
what has the same id once. What moves a robot is not done late where another request was done since: that one may have
stopped it. What holds it (disarm, pause) always is.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Generic, NamedTuple, Protocol, TypeVar

import msgspec

from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.watch import Watch
from station.errors import NotReady, Refused

OVERTAKEN = "a request that was asked for after it was done before it; look at the robot, then ask again"
"""Why what moves a robot is not done late."""

LateS = Annotated[float, msgspec.Meta(ge=0.0, le=86400.0)]
"""How long after it was first written a request was written again [s]."""

_AGAIN_S = 0.5
_LOOK_S = 0.2
_REMEMBERED = 64

AnswerT = TypeVar("AnswerT")
RequestT = TypeVar("RequestT", bound=msgspec.Struct)


def new_id() -> str:
    """Return an id that no other request has."""
    return secrets.token_hex(6)


def parse(data: bytes, kind: type[RequestT], what: str) -> RequestT:
    """Return the request that bytes from the bus hold.

    Raises:
        Refused: they hold none of this kind; ``not an arm request: …``, where `what` is "an arm request".
    """
    try:
        return codec.parse_struct(data, kind)
    except codec.BadValue as error:
        raise Refused(f"not {what}: {error}") from error


def ask(
    bus: Bus,
    watch: Watch,
    key: str,
    request: msgspec.Struct,
    answers: Mapping[str, Callable[[bytes], AnswerT | None]],
    *,
    what: str,
    within_s: float,
    is_repeated: bool = True,
) -> dict[str, AnswerT]:
    """Write a request until it is answered on each of some keys; return the answers that came, by key.

    Args:
        bus: The bus that the servers listen on.
        watch: Watches the keys of the answers.
        key: Where requests of this kind are written.
        request: What is asked for; it has an `id`, and, where it is repeated, a `late_s`.
        answers: By key where an answer comes: returns it where a value of that key has it, else None.
        what: What is asked for, in words, for errors.
        within_s: Longest wait [s].
        is_repeated: Whether to write it every half second; else again only to a bus that was away meanwhile.

    Raises:
        NotReady: the bus did not take the request.
    """
    clock, again_s = bus.clock, _AGAIN_S if is_repeated else math.inf
    began_s, sent_s, sent_on = clock.monotonic_s(), -math.inf, 0
    deadline_s = began_s + within_s
    found: dict[str, AnswerT] = {}
    has_tried = False  # once, however late this process is
    for place, answer_in in answers.items():
        newest: Any = None
        while place not in found and ((now_s := clock.monotonic_s()) < deadline_s or not has_tried):
            has_tried = True
            if watch.connections != sent_on or now_s - sent_s >= again_s:
                if is_repeated:
                    request = msgspec.structs.replace(request, late_s=now_s - began_s)
                if bus.publish({key: codec.json_object(request)}):
                    sent_s, sent_on = now_s, watch.connections
                elif bus.is_connected:
                    raise NotReady(f"{what}: the bus {bus.address} did not take the request ({bus.last_error})")
            newest = watch.wait(place, after=newest, timeout_s=max(0.0, min(deadline_s - now_s, _LOOK_S))) or newest
            sample = newest or watch.latest(place)  # without an age where it came while notifications were cut
            if sample is not None and (answer := answer_in(sample.value)) is not None:
                found[place] = answer
    if sent_s == -math.inf:
        raise NotReady(f"{what}: the bus {bus.address} has been gone for {within_s:g} s ({bus.last_error})")
    return found


class Answer(Protocol):
    """What came of a request to one robot."""

    @property
    def refused(self) -> str:
        """Why nothing was done, or ""."""
        ...


def ask_robot(
    bus: Bus,
    robot: str,
    key: str,
    request: msgspec.Struct,
    answer_in: Callable[[bytes], Answer | None],
    *,
    what: str,
    within_s: float,
) -> None:
    """Ask the server of one robot, which answers in that robot's ``command_gate``, and wait until it is done.

    Args:
        bus, key, request, what, within_s: As in `ask`.
        robot: Suffix of the robot's keys.
        answer_in: Returns the answer where a value of the gate has it, else None.

    Raises:
        NotReady: the bus did not take the request, or no answer came.
        Refused: it said no; with its reason.
    """
    gate = keys.command_gate(robot)
    with bus.watch([gate]) as watch:
        answer = ask(bus, watch, key, request, {gate: answer_in}, what=what, within_s=within_s).get(gate)
    if answer is None:
        raise NotReady(f"{robot}: no answer within {within_s:g} s; does its server run? `station status` tells")
    if answer.refused:
        raise Refused(f"{robot}: {answer.refused}")


class Asked(NamedTuple):
    """A request as it was found on its key.

    Attributes:
        data: Its bytes.
        written_ns: When it was written, on this machine's monotonic clock; when it arrived, for a writer elsewhere; 0
            where neither is known.
    """

    data: bytes
    written_ns: int

    def first_ns(self, late_s: float) -> int:
        """Return when it was first written, by how long before this writing that was [s]."""
        return self.written_ns - round(late_s * 1e9)


class NewRequests:
    """The value of a watched key, once for each that came; what stood there before is no request.

    Args:
        watch: Watches the key.
        key: The key.
        is_age_needed: Whether to pass over what was found after a cut, and may have been written long ago.
    """

    def __init__(self, watch: Watch, key: str, *, is_age_needed: bool = True) -> None:
        self._watch, self._key, self._seen = watch, key, watch.latest(key)
        self._is_age_needed = is_age_needed

    @property
    def has_come(self) -> bool:
        """Whether one came since the last `pop`."""
        return self._watch.latest(self._key) is not self._seen

    def pop(self) -> Asked | None:
        """Return the newest that came since the last call, else None."""
        sample = self._watch.latest(self._key)
        if sample is self._seen:
            return None
        self._seen = sample
        if sample is None or (self._is_age_needed and sample.arrived_ns is None):
            return None
        mark, arrived_ns = sample.stamp, sample.arrived_ns or 0
        is_ours = mark is not None and mark.is_from_this_boot
        return Asked(sample.value, min(mark.mono_ns, arrived_ns) if mark is not None and is_ours else arrived_ns)


class DoneRequests(Generic[AnswerT]):
    """What became of requests: their answers by id, for one that is written again, and when the newest was written."""

    def __init__(self) -> None:
        self._answers: dict[str, AnswerT] = {}
        self._newest_ns = 0

    def get(self, asked: str) -> AnswerT | None:
        """Return the answer to a request; None where it is new, or has no id."""
        return self._answers.get(asked)

    def begin(self, first_ns: int) -> bool:
        """Begin a request that was first written then [ns]; return whether one that was written later was before."""
        is_overtaken, self._newest_ns = first_ns < self._newest_ns, max(self._newest_ns, first_ns)
        return is_overtaken

    def put(self, asked: str, answer: AnswerT) -> None:
        """Keep an answer; one to a request without an id is not kept."""
        if asked:
            self._answers[asked] = answer
        while len(self._answers) > _REMEMBERED:
            del self._answers[next(iter(self._answers))]
