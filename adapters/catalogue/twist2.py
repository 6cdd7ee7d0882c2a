"""TWIST2's policy, robot model and example motions, as they were at one commit."""

from __future__ import annotations

from pathlib import Path

from station.assets import read_collection

COLLECTION = read_collection(Path(__file__).with_suffix(".toml"))
