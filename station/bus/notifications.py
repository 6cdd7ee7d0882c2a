"""The server's word of each write: which of its events readers need, and whether it still sends them.

The setting is one for all clients. A client that sets it to what it needs takes it from all others, and the
server goes on answering all questions as if nothing were the matter.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

from station.bus.connection import Argument, Connection, ConnectionLost
from station.errors import BusError

log = logging.getLogger(__name__)

SETTING = "notify-keyspace-events"
NEEDED_EVENTS = "K$gx"  # keyspace channels; strings; generic (del, rename); expired
ASK_FLAGS = ("CONFIG", "GET", SETTING)


def flags_of(answer: Any) -> str:
    """Return the flags in the answer to `ASK_FLAGS`.

    Raises:
        BusError: there are none in it.
    """
    if isinstance(answer, list) and len(answer) == 2 and isinstance(answer[1], bytes):
        return answer[1].decode()
    raise BusError(f"the bus does not tell its {SETTING}: {answer!r}")


def missing_events(flags: str) -> str:
    """Return the flags that a reader needs and that are not among these."""
    return "".join(flag for flag in NEEDED_EVENTS if flag not in flags and not ("A" in flags and flag != "K"))


def taken_away(flags: str) -> str:
    """Return what has happened where flags that we saw to are gone, and what to do about it."""
    return (
        f"some client set {SETTING} to '{flags}', and no write was told of any more; "
        f"have it keep {NEEDED_EVENTS} beside its own flags"
    )


def switch_on(connection: Connection) -> str:
    """Switch on the events that readers need, beside those that others asked for; return why not, or "".

    Raises:
        BusError: the connection is lost.
    """
    try:
        flags = flags_of(connection.call(*ASK_FLAGS))
        if missing := missing_events(flags):
            connection.call("CONFIG", "SET", SETTING, flags + missing)
    except BusError as error:
        if connection.fileno() < 0:
            raise
        return str(error)
    return ""


def enable_notifications(connection: Connection) -> bool:
    """Switch on the events that readers need, beside those that others asked for; False, and a line, when refused.

    Raises:
        BusError: the connection is lost.
    """
    if refusal := switch_on(connection):
        log.warning("bus %s refuses keyspace notifications: %s", connection.address, refusal)
    return not refusal


def subscribe(events: Connection, channels: Sequence[Argument], timeout_s: float) -> None:
    """Subscribe to channels, and take the answers.

    Raises:
        BusError: it was refused, or not answered in time: a reader that goes on would hear nothing for ever.
    """
    events.send("SUBSCRIBE", *channels)
    for _ in channels:
        try:
            answer = events.receive(timeout_s)
        except TimeoutError as error:
            raise ConnectionLost(f"bus {events.address}: no answer to a subscription in time") from error
        if isinstance(answer, Exception):
            raise BusError(f"bus {events.address} refuses subscriptions: {answer}")


def is_answer(message: Any) -> bool:
    """Whether a message answers a PING on a subscribed line: an error does too, in its order; a user may lack PING."""
    return message == b"PONG" or isinstance(message, Exception) or (isinstance(message, list) and message[0] == b"pong")
