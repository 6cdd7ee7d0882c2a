"""What the server of an arm registers beside what every server does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from station.life.server import ServerKind


class ArmServerKind(ServerKind, frozen=True, kw_only=True):
    """A kind of server whose arm has a controller of its own.

    Attributes:
        bridge: Imports and returns the native package that speaks with the controller, and simulates one. Raises
            `StationError` where it is not installed.
    """

    bridge: Callable[[], Any]
