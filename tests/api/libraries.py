"""Libraries of the extra `frames`."""

from __future__ import annotations

import importlib.util
import os

import pytest


def needs(*names: str) -> None:
    """Skip a test on a machine that lacks a library; CI installs them and fails."""
    missing = [name for name in names if importlib.util.find_spec(name) is None]
    if missing:
        message = f"{' and '.join(missing)} not installed: pip install 'teleop-station[frames]'"
        (pytest.fail if os.environ.get("CI") else pytest.skip)(message)
