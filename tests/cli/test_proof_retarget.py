"""The robot walks what a file of any format says that a person walked."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.adapters.captures.written import write_amass, write_bvh
from tests.cli.running import Home
from tests.cli.test_retarget import assert_walked, walker

pytestmark = pytest.mark.usefixtures("processes")


def test_the_tracker_walks_what_each_format_says(proof: object, home: Home, tmp_path: Path) -> None:
    write_bvh(tmp_path / "bvh.bvh", walker())
    write_amass(tmp_path / "amass.npz", walker())
    assert_walked(home, tmp_path, 2)
