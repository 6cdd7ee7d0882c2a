"""What a user means where a command line and the environment say nothing: ``$XDG_CONFIG_HOME/station/config.yaml``.

No file of the current folder counts: where a stop goes must not depend on the folder in which somebody asks for it.
"""

from __future__ import annotations

import getpass
import os
from functools import lru_cache
from pathlib import Path

import msgspec

from station import config


class UserConfig(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Defaults of a user.

    Attributes:
        data: Folder of episodes; None: ``./data``.
        bus: Address of the bus; "" for this user's own.
        bulk: Address of its bulk bus, for depth and clouds; "" for the one beside it, if there is one.
        operator: Who operates, for episodes; "" for the login name.
    """

    data: Path | None = None
    bus: str = ""
    bulk: str = ""
    operator: str = ""


def folder() -> Path:
    """Return the folder of this user's own files for the station; perhaps not there."""
    base = os.environ.get("XDG_CONFIG_HOME")
    return (Path(base) if base else Path.home() / ".config") / "station"


def path() -> Path:
    """Return where the defaults are kept; perhaps not there."""
    return folder() / "config.yaml"


def user_config() -> UserConfig:
    """Return the defaults of this user.

    Raises:
        BadFile, ConfigError: the file cannot be read, or has what it must not have.
    """
    file = path()
    try:
        changed_ns = file.stat().st_mtime_ns
    except OSError:
        return UserConfig()
    return _read(file, changed_ns)


def operator(named: str = "") -> str:
    """Return who operates: who is named, else the user's default, else the login name."""
    return named or user_config().operator or getpass.getuser()


@lru_cache(maxsize=1)
def _read(file: Path, _changed_ns: int) -> UserConfig:
    found = config.build(UserConfig, config.read_yaml(file), where=str(file))
    if found.data is None:
        return found
    return msgspec.structs.replace(found, data=file.parent / found.data.expanduser())
