"""Teleop Station: what every process of a station shares, and the few names that a notebook or a script needs.

``station.open_episode("latest")`` opens a recorded episode as arrays and frames, ``station.Station()`` is a line to a
running station, ``station.AsyncStation()`` one for asyncio; docs/notebook.md and docs/script.md show how.
"""

import importlib
import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from station.api.aio import AsyncStation
    from station.api.episode import Episode, open_episode
    from station.api.live import Station
    from station.errors import StationError

__all__ = ["AsyncStation", "Episode", "Station", "StationError", "open_episode"]

# ONNX Runtime 1.32 sends usage data to its maker, from a thread beside the control loop. It reads this when imported.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

if not TYPE_CHECKING:  # a type checker shall know these names alone, and tell of a misspelt one

    def __getattr__(name):
        """Import a public name when it is first asked for: every process of a station imports this module."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        modules = {
            "AsyncStation": "station.api.aio", "Station": "station.api.live", "StationError": "station.errors",
        }  # fmt: skip
        module = modules.get(name, "station.api.episode")
        return getattr(importlib.import_module(module), name)

    def __dir__():
        """Return the names of the module, public ones that are not imported yet too."""
        return sorted({*globals(), *__all__})
