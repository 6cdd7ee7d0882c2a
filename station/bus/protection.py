"""Whether strangers can reach a bus: where it listens, and whether it asks for a password.

The published TWIST set-up opens Redis to the network without one; anybody there can then move the robot.
"""

from __future__ import annotations

import contextlib
import secrets
from typing import Literal

import msgspec

from station.bus import keys
from station.bus.address import is_loopback
from station.bus.client import Bus
from station.bus.connection import Connection, ConnectionLost
from station.errors import BusError

Verdict = Literal["closed", "open", "unknown"]
REMEDY = (
    "start it with `station bus start` (a socket of yours alone) or `station bus start --bind ADDRESS` (a password); "
    "a server of your own: set requirepass, or an ACL as `station bus acl` prints it, or bind it to 127.0.0.1"
)


class Protection(msgspec.Struct, frozen=True):
    """What was found, in a line.

    Attributes:
        verdict: ``open``: anybody who reaches this machine over the network may write. ``unknown``: we may not ask.
        found: Why.
        listens: Addresses that the server listens on, as far as it told us.
    """

    verdict: Verdict
    found: str
    listens: str = ""


class _Settings(msgspec.Struct, frozen=True):
    bind: str
    port: str
    tls_port: str
    protected_mode: str
    tls_auth_clients: str

    @property
    def outside(self) -> list[str]:
        """The addresses that other machines can reach."""
        if self.port == "0" and self.tls_port in ("0", ""):
            return []
        named = [word.removeprefix("-") for word in self.bind.split()] or ["*"]
        return [word for word in named if not is_loopback(word)]


def inspect(bus: Bus) -> Protection:
    """Return how a bus that we are logged in to is protected; writes nothing."""
    settings = _settings(bus)
    if settings is not None and not settings.outside:
        where = "a unix socket" if settings.port == "0" and settings.tls_port in ("0", "") else "loopback addresses"
        return Protection("closed", f"listens on {where} only", settings.bind)
    may_write = _stranger_may_write(bus)
    listens = "" if settings is None else ", ".join(settings.outside)
    if not may_write:
        return Protection("closed", "asks for a password", listens)
    if settings is None:
        return _by_our_own_way(bus)
    if settings.port == "0" and settings.tls_auth_clients == "yes":
        return Protection("closed", "asks for a certificate", listens)
    if settings.protected_mode == "yes":
        return Protection("closed", "in protected mode: refuses other machines", listens)
    return Protection(
        "open", f"open to the network ({listens}) without a password: anybody there can move the robot", listens
    )


def _by_our_own_way(bus: Bus) -> Protection:
    """Judge a server that tells nothing of itself by how we reach it."""
    address = bus.address
    if address.socket is None and not is_loopback(address.host):
        return Protection(
            "open", "open to the network without a password: anybody there can move the robot", address.host
        )
    return Protection("unknown", "asks for no password, and does not say where it listens")


def _settings(bus: Bus) -> _Settings | None:
    try:
        found = [_setting(bus, name) for name in ("bind", "port", "tls-port", "protected-mode", "tls-auth-clients")]
    except BusError:  # not allowed to ask
        return None
    return _Settings(*found)


def _setting(bus: Bus, name: str) -> str:
    answer = bus.call("CONFIG", "GET", name)
    return answer[1].decode("utf-8", "replace") if len(answer) > 1 else ""


def _stranger_may_write(bus: Bus) -> bool:
    """Whether a client without a name may write a command; tried on a key that is not there, and stays away."""
    nobody = msgspec.structs.replace(bus.address, username=None, password=None)
    try:
        with contextlib.closing(Connection(nobody, timeout_s=1.0)) as line:
            line.call("SET", keys.command_source(f"nobody_{secrets.token_hex(4)}"), b"", "XX")
    except ConnectionLost:
        raise
    except BusError:  # asked for a password, or refused the write
        return False
    return True
