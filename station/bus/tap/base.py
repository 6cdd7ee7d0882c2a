"""What every tap is, and what the three of them share."""

from __future__ import annotations

import secrets
from typing import Literal, NamedTuple, Protocol

import msgspec

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.errors import BusError

Backend = Literal["replication", "notifications", "poll"]
PROBE = keys.TAP_PROBE.encode()
CALL_TIMEOUT_S = 2.0  # answers to set-up requests; a tap is not part of a control loop
PROBE_LIFE_MS = 10_000

MOST_KEYS = 20_000
"""Keys that a tap remembers where it has to; a client that invents keys must not fill the memory. A station has 100."""


class Write(NamedTuple):
    """One write as the bus saw it.

    Attributes:
        key: Key that was written; bytes that are not UTF-8 appear as ``\\xNN``.
        value: Exact bytes of the value; None when the key was deleted or expired.
        stamp: Exact bytes of the stamp that the same command wrote beside it; None from a foreign writer.
        mono_ns: Arrival at the tap, on this machine's monotonic clock [ns].
    """

    key: str
    value: bytes | None
    stamp: bytes | None
    mono_ns: int


class Snapshot(NamedTuple):
    """What a database held at the instant at which a probe was written.

    Attributes:
        probe: The probe's value.
        values: Of its string keys.
        unread: Further keys that were there: too large, or too many.
        is_whole: Whether these are all its keys.
    """

    probe: bytes
    values: dict[bytes, bytes]
    unread: tuple[bytes, ...]
    is_whole: bool


class Position(msgspec.Struct, frozen=True):
    """A place in the server's stream of writes, from which a later tap can go on.

    Attributes:
        replication_id: The server's history; a restarted server has another.
        offset: Bytes of that history that were consumed.
        db: Database that the stream had selected there; None takes it for the tapped one. The server does not repeat
            its SELECT after a resumption, so the offset alone does not say whose writes follow.
        bulk: The place in the stream of the bulk bus that goes with it; None where there is none.
    """

    replication_id: str
    offset: int
    db: int | None = None
    bulk: Position | None = None


class Tap(Protocol):
    """A line from the bus on which writes arrive. One thread reads it.

    A change of a key that it knows of and cannot show is a write of `keys.NOT_MIRRORED`.

    Attributes:
        backend: How it listens.
        is_lossless: Whether every single write arrives; else a value may be overwritten before it is read.
        resumed: None when no resumption was asked for; True when it goes on without a hole, False when there is one.
        is_catching_up: Whether what `read` returns was written long before, while no tap was there.
        unseen_keys: The most keys so far that there were beyond those that it can look at.
    """

    backend: Backend
    is_lossless: bool
    resumed: bool | None
    is_catching_up: bool
    unseen_keys: int

    def read(self, timeout_s: float) -> list[Write]:
        """Return what arrived, in the order of the bus; empty when nothing came in time.

        Raises:
            BusError: the link is lost; open another tap, with `position` where there is one.
        """
        ...

    def may_wait(self) -> bool:
        """Whether nothing would be lost if what comes were read a little later."""
        ...

    def position(self) -> Position | None:
        """Return the place behind the last write that `read` returned; None where there is no such thing."""
        ...

    def close(self) -> None:
        """Hang up; a second call does nothing."""
        ...


class TapRefused(BusError):
    """The server lives but does not offer this backend to us; another may do."""


def connect(address: BusAddress) -> Connection:
    """Return a connection for set-up requests."""
    return Connection(address, timeout_s=CALL_TIMEOUT_S)


def new_token() -> bytes:
    """Return a value for the probe that no other tap has."""
    return secrets.token_hex(8).encode()


def write_probe(connection: Connection) -> bytes:
    """Write the key that a tap must see before it may call itself armed; returns the value to look for.

    Raises:
        BusError: this user may not write the key.
    """
    token = new_token()
    try:
        connection.call("SET", PROBE, token, "PX", PROBE_LIFE_MS)
    except BusError as error:
        if connection.fileno() < 0:
            raise
        raise BusError(
            f"cannot prove that the tap works: may not write {keys.TAP_PROBE} ({error}); allow it"
        ) from error
    return token


def why_not_resumed(before: Position | None, after: Position | None) -> str:
    """Return why a tap could not go on where the one before it was lost, for a person."""
    if before is None or after is None:
        return "a tap of this kind cannot ask for what it missed"
    if before.replication_id != after.replication_id:
        return "the bus was restarted, or is another server"
    return "the bus no longer had what was written meanwhile (its backlog is too small)"


def key_name(key: bytes) -> str:
    """Return a key as text; what is not UTF-8 is escaped, so that it can stand in any file."""
    return key.decode("utf-8", "backslashreplace")
