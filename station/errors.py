"""Every error a user can meet, in one tree.

    StationError            exit code 1: something in the world is not as needed
    ├── UsageError          exit code 2: the user asked for something that cannot be
    │   ├── ConfigError     a file or a --set value does not fit its type
    │   ├── UnknownName     a name that is not registered; says which names are
    │   └── BadFile         a file that is missing, torn, malicious or of the wrong shape
    ├── AssetMissing        upstream data is not on this machine
    ├── BusError            the Redis bus: unreachable, refused, lost, busy
    │   └── StoppedPastBus  it did not take an emergency stop, but robots of this machine were told past it
    ├── NotReady            a server did not come up, or died
    ├── Refused             a request that the receiving server turned down
    └── EpisodeError        an episode that cannot be read, written or found

A message is one line: what was wrong, what was expected, what came, what to do.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_TELLING = 3  # letters of a beginning that say what was meant


class StationError(Exception):
    """Base of all errors that are shown to the user as one line."""

    exit_code = 1


class UsageError(StationError):
    """The request itself is wrong; running it again cannot help."""

    exit_code = 2


class Interrupted(StationError):
    """Ctrl-C, with what there is to say of it; the exit code is a shell's."""

    exit_code = 130


class ConfigError(UsageError):
    """A configuration value, key or file does not fit its type."""


class UnknownName(UsageError):
    """A name that nothing is registered under."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        self.kind, self.name, self.known = kind, name, sorted(known)
        listed = ", ".join(self.known) or "none"
        super().__init__(f"unknown {kind} {name!r}{did_you_mean(name, self.known)}; known: {listed}")


class BadFile(UsageError):
    """A file that is missing, unreadable, malicious or of the wrong shape."""


class AssetMissing(StationError):
    """Upstream data that is not on this machine."""


class BusError(StationError):
    """The bus cannot be reached, refused us, was lost, or its address is busy."""


class StoppedPastBus(BusError):
    """The bus did not take an emergency stop; servers of this machine that drive a robot were told past it.

    Attributes:
        told: Their names.
    """

    def __init__(self, message: str, told: Iterable[str]) -> None:
        self.told = tuple(told)
        super().__init__(message)


class NotReady(StationError):
    """A server did not become ready in time, or died before it did."""


class Refused(StationError):
    """A request that the server it went to turned down, with its reason."""


class EpisodeError(StationError):
    """An episode that cannot be read, written or found."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for the closest known name, or nothing."""
    names = list(known)
    begins = [other for other in names if len(name) >= _TELLING and other.startswith(name)]
    close = begins or difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    return f" (did you mean {close[0]!r}?)" if close else ""
