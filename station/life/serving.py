"""Runs a server in this process: from the connection to the bus to its last word.

`serve` claims the server's name, hands a `Life` to the server's ``main(config, life) -> int`` and hears the signals
that ask it to stop.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import traceback
from pathlib import Path

import msgspec

from station.bus import address as addresses
from station.bus import keys, password_file
from station.bus.address import PASSWORD_FILE_VARIABLE, USER_VARIABLE, BusAddress
from station.bus.client import Bus
from station.bus.protection import inspect
from station.errors import BusError, Refused, StationError
from station.life.server import Life, ServerKind, read_health
from station.stop_signals import set_on_signals

log = logging.getLogger(__name__)

_PATIENCE_S = 1.0  # for an answer of the bus, while a server loads and nothing moves


def serve(kind: ServerKind, config: msgspec.Struct, *, address: BusAddress | None = None, name: str = "") -> int:
    """Run a server in this process until it ends or is asked to; return its exit code.

    Raises:
        BusError: the bus cannot be reached at the start.
        Refused: a live server already has this name, or this user of the bus may not say how the server is doing.
    """
    name = name or kind.name
    with Bus(for_role(address or addresses.default(), kind.role), name=name, timeout_s=_PATIENCE_S) as bus:
        _claim(bus, name)
        _warn_of_strangers(bus)
        life = Life(kind, name, bus, _config_hash(config))
        set_on_signals(life.stop_event, second_interrupts=True)  # the second does not wait for a clean end
        reason = "stopped"
        try:
            _expect_allowed(bus, name, kind.role)
            code = kind.main(config, life)
            if life.failure is not None:
                raise life.failure
            return code
        except StationError as error:
            reason = str(error)
            life.last_word("server-failed", reason=reason)
            raise
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            life.last_word("server-crashed", reason=reason, where=traceback.format_exc(limit=-3))
            raise
        finally:
            life.end(reason)


def _claim(bus: Bus, name: str) -> None:
    for health in read_health(bus):
        if health.name == name and health.is_alive_at(bus.clock.wall_ns()):
            raise Refused(
                f"server {name!r} is already running on {bus.address} (pid {health.pid} on {health.host}); "
                "stop it first, or start this one under another --name"
            )


def _expect_allowed(bus: Bus, name: str, role: str) -> None:
    bus.call("PING")  # answered after the first heartbeat
    if "NOPERM" in bus.last_error:
        raise Refused(
            f"user {bus.address.username or 'default'!r} of the bus may not write {keys.server(name)}; expected user "
            f"{role!r}: name the file of its password in ${PASSWORD_FILE_VARIABLE}, and no other user in "
            f"${USER_VARIABLE}; where the list is made for runbooks, for one with this server"
        )


def _warn_of_strangers(bus: Bus) -> None:
    with contextlib.suppress(BusError):  # the bus is being lost: a later look will tell
        protection = inspect(bus)
        if protection.verdict == "open":
            log.warning("bus %s: %s", bus.address, protection.found)


def _config_hash(config: msgspec.Struct) -> str:
    return hashlib.sha256(msgspec.json.encode(config, enc_hook=str)).hexdigest()


def for_role(address: BusAddress, role: str) -> BusAddress:
    """Return the address with the user of a role, where a file of passwords has one; else as it is.

    So a server that a supervisor starts logs in as what it is, not as its supervisor. A user that the environment
    names is meant, and stays.
    """
    file = None if os.environ.get(USER_VARIABLE) else os.environ.get(PASSWORD_FILE_VARIABLE)
    password = password_file.read(Path(file)).get(role) if file else None
    return address if password is None else msgspec.structs.replace(address, username=role, password=password)
