"""A server that is started by hand says what it lacks before it asks for a bus."""

from __future__ import annotations

import pytest

from station import libraries
from station.cli import serve
from station.errors import StationError


def test_a_robot_whose_library_is_missing_names_the_extra(monkeypatch):
    monkeypatch.setattr(libraries, "version", lambda library: None)
    nothing = {"bus": None, "name": "", "config_json": "", "is_expected": False, "list_keys": False}
    with pytest.raises(StationError, match=r"robot g1-dds needs cyclonedds, .*; pip install 'teleop-station\[g1\]'"):
        serve.command.callback(server="robot", sets=("robot=g1-dds",), **nothing)
