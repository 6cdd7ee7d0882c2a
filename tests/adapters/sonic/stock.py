"""SONIC's own builders of messages, unchanged, from the upstream data: an independent peer."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType


def stock(assets: Path) -> ModuleType:
    """Import the builders."""
    path = assets / "peers" / "gear_sonic" / "zmq_planner_sender.py"
    spec = importlib.util.spec_from_file_location("stock_sonic", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["stock_sonic"] = module
    spec.loader.exec_module(module)
    return module
