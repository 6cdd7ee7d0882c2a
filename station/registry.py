"""What can be registered by name: servers, devices, cameras, drivers, robots, policies, motion readers (by suffix) …

Each kind is an entry point group, so a third-party package adds its own in its ``pyproject.toml`` and
nothing here changes. Loading an entry imports its module; listing names imports nothing.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal, get_args

import msgspec

from station import packages, python_child
from station.errors import StationError, UnknownName

Kind = Literal[
    "server",
    "robot",
    "twin",
    "family",
    "policy",
    "motion",
    "command",
    "loader",
    "capture",
    "retargeter",
    "asset",
    "driver",
    "device",
    "camera",
    "lidar",
    "export",
    "foreign",
    "voice",
]

INSTALL = "pip install -e . in a checkout, pip install --upgrade teleop-station elsewhere"

_GROUPS: dict[str, str] = {
    "server": "station.servers",
    "robot": "station.robots",
    "twin": "station.twins",
    "family": "station.families",
    "policy": "station.policies",
    "motion": "station.motions",
    "command": "station.commands",
    "loader": "station.loaders",
    "capture": "station.captures",
    "retargeter": "station.retargeters",
    "asset": "station.assets",
    "driver": "station.drivers",
    "device": "station.devices",
    "camera": "station.cameras",
    "lidar": "station.lidars",
    "export": "station.exports",
    "voice": "station.voices",
    "foreign": "station.foreign",
}


def named(kind: Kind) -> msgspec.Meta:
    """Return what an annotation says of a setting that is a registered name: ``Annotated[str, named("policy")]``."""
    return msgspec.Meta(extra={"registered": kind})


# Of every group at once: a call reads a file of each distribution, 20 ms of a processor where a hundred are installed.
_installed = cache(entry_points)


@cache
def _entries(kind: Kind) -> dict[str, EntryPoint]:
    entries = {entry.name: entry for entry in _installed().select(group=_GROUPS[kind])}
    if kind == "server":  # a device is a server by its name: `station.operator.device_kind.DeviceKind.server`
        group, devices = _GROUPS[kind], _entries("device").items()
        return {name: EntryPoint(name, f"{entry.value}.server", group) for name, entry in devices} | entries
    return entries


def names(kind: Kind) -> list[str]:
    """Return the registered names of one kind, sorted; imports nothing."""
    return sorted(_entries(kind))


def is_ours(kind: Kind, name: str) -> bool:
    """Whether a registered name stands for something of our own packages; imports nothing."""
    return _entries(kind)[name].value.partition(".")[0] in packages.IMPORTED


def outdated() -> str:
    """Return what of ours cannot be found by name, because the installation is older than the code; "" for nothing."""
    kinds = [kind for kind in get_args(Kind) if not any(is_ours(kind, name) for name in names(kind))]
    if not kinds:
        return ""
    return f"nothing of ours is registered as {' or '.join(kinds)}: the installation is older than its files"


def expect(kind: Kind, name: str) -> None:
    """Check a name without loading what it names, for a configuration's ``__post_init__``.

    Raises:
        ValueError: nothing is registered under it; the message lists what is.
    """
    if name not in _entries(kind):
        raise ValueError(str(UnknownName(kind, name, _entries(kind))))


def find(kind: Kind, name: str) -> Any:
    """Load what is registered under a name.

    Raises:
        UnknownName: nothing is registered under it; the message lists what is.
        StationError: it cannot be loaded, or a foreign package has the name of one of ours, and hides it.
    """
    entry = _entries(kind).get(name)
    if entry is None:
        raise UnknownName(kind, name, _entries(kind))
    _expect_our_packages()
    try:
        with python_child.importing():
            return entry.load()
    except (ImportError, AttributeError) as error:
        if (foreign := next(packages.foreign(), None)) is not None:
            raise StationError(f"{foreign} ({error})") from error
        mend = INSTALL if is_ours(kind, name) else "mend or uninstall the package that registers it"
        raise StationError(f"{kind} {name!r} ({entry.value}) cannot be loaded: {error}; {mend}") from error


@cache
def _expect_our_packages() -> None:
    packages.expect_ours()
