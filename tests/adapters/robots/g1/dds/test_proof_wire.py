"""A minute with another program on the same wire (R3)."""

from __future__ import annotations

import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from tests.adapters.robots.g1.dds import far


@pytest.mark.timeout(300)
def test_r3_a_minute_each_way(proof, processes):
    said, came, damaged = far.command_its_robot(60.0)
    assert (damaged, came > 25_000, said["commands"] > 2500) == (0, True, True)
    said, came, damaged = far.be_its_robot(60.0)
    assert (damaged, came > 25_000, said["states"] > 2500) == (0, True, True)
