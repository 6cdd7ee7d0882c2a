"""Tests of the package in `bridges/kord`; skipped where it is not built, but never in CI."""

import importlib.util
import os

import pytest

if importlib.util.find_spec("station_kord") is None and not os.environ.get("CI"):
    pytest.skip("station_kord is not built: pip install ./bridges/kord", allow_module_level=True)
