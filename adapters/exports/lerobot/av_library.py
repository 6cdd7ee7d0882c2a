"""PyAV, or one line that says how to get it."""

from __future__ import annotations

import importlib
from typing import Any

from station.errors import StationError


def _load() -> Any:
    try:
        return importlib.import_module("av")
    except ImportError as error:
        raise StationError(
            f"video needs PyAV ({error}); install it with `pip install 'teleop-station[video]'`, "
            "or leave the pictures out with --camera none"
        ) from error


av: Any = _load()
