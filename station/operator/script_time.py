"""Where the script of a fake device stands: told with a device server's configuration, and found again after a restart.

A device server may be started again by itself. Its fake's operator goes on meanwhile, as a real one would.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

from station.bus import codec, keys
from station.life.restarts import RESTARTS_VARIABLE
from station.life.server import Life

_BEGAN = "fake_began_wall_ns"


def begin(fake: Callable[[], object], start_s: float) -> dict[str, Any]:
    """Let a fake begin, at a time of its script [s]; return what a manifest says of it: since when it is played."""
    fake()
    return {_BEGAN: time.time_ns() - round(start_s * 1e9)}


def now_s(life: Life) -> float:
    """Return where the script stands [s]: 0, or after a restart of this server the time since it began."""
    if os.environ.get(RESTARTS_VARIABLE, "0") == "0":
        return 0.0
    began_ns = codec.number(codec.parse_facts(life.bus.get(keys.server_config(life.name))).get(_BEGAN))
    return 0.0 if began_ns is None else max(0.0, (time.time_ns() - began_ns) * 1e-9)
