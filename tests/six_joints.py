"""The command of an arm of six joints, as a package of somebody else registers it."""

from __future__ import annotations

from importlib.metadata import EntryPoint

import numpy as np
import pytest

from station import registry
from station.arms import JointCommand

JOINTS = ("base", "shoulder", "elbow", "forearm", "wrist", "flange")
COMMAND = JointCommand.within(
    "six", "six", JOINTS, lower=np.full(6, -2.0), upper=np.full(6, 2.0), margin=np.full(6, 0.2), rate=np.full(6, 1.0)
)


def register(patch: pytest.MonkeyPatch) -> None:
    """Let it be found as `six`."""
    entry = EntryPoint("six", f"{__name__}:COMMAND", "station.commands")
    patch.setitem(registry._entries("command"), "six", entry)
