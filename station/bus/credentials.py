"""Who we are on a protected bus, where each role has a user of its own."""

from __future__ import annotations

import os
from pathlib import Path

import msgspec

from station.bus import password_file
from station.bus.address import PASSWORD_FILE_VARIABLE, USER_VARIABLE, BusAddress


def for_role(address: BusAddress, role: str) -> BusAddress:
    """Return the address with the user of a role, where a file of passwords has one; else as it is.

    So a server that a supervisor starts logs in as what it is, not as its supervisor. A user that the environment
    names is meant, and stays.
    """
    file = None if os.environ.get(USER_VARIABLE) else os.environ.get(PASSWORD_FILE_VARIABLE)
    password = password_file.read(Path(file)).get(role) if file else None
    return address if password is None else msgspec.structs.replace(address, username=role, password=password)
