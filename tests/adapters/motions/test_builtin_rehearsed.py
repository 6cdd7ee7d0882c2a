"""TWIST2 does every built-in clip: what was made by kinematics holds in physics, by a policy that never saw it."""

from __future__ import annotations

from pathlib import Path

import pytest

from adapters.motions import builtin
from adapters.robots import g1
from station.life.rig import RigConfig
from station.rehearse import rehearse_all

pytestmark = pytest.mark.assets

MODEL = Path(g1.__file__).with_name("g1.xml")


def test_twist2_does_every_clip_without_a_fall(assets: Path) -> None:
    config = RigConfig(policy="twist2", robot_model=str(MODEL), physics_dt_s=0.002)
    results = rehearse_all([f"builtin:{name}" for name in builtin.names()], config)
    assert [result.motion for result in results if result.fell] == []
    errors = {result.motion: result.mean_joint_error_rad or 1.0 for result in results}
    assert {
        motion: error for motion, error in errors.items() if error > 0.08
    } == {}  # 0.04 to 0.065; examples 0.06-0.09
