"""Built-in clips hold in physics, not only in kinematics: by the policy that is built in, and by TWIST2's. Both do all
of them in `tests/test_proof_rehearse.py`; the tour is the demo's (`tests/cli/test_demo.py`)."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from station.control.rig import RigConfig
from station.rehearse import rehearse_all

pytestmark = pytest.mark.usefixtures("processes")

TRIED = ("reach-both", "walk-arc")
TRIED_WITH_TWIST2 = ("squat", "walk-forward")


def test_our_policy_does_clips_without_a_fall() -> None:
    assert_done("tracker", TRIED)


@pytest.mark.assets
def test_the_policy_of_twist2_does_what_it_was_not_trained_on_without_a_fall() -> None:
    assert_done("twist2", TRIED_WITH_TWIST2)


def assert_done(policy: str, names: Sequence[str]) -> None:
    config = RigConfig(policy=policy, robot_options={"model": "builtin:g1.xml", "physics_dt_s": 0.002})
    results = rehearse_all([f"builtin:{name}" for name in names], config)
    assert len(results) == len(names)
    assert [result.motion for result in results if result.fell] == []
    errors = {result.motion: result.mean_joint_error_rad or 1.0 for result in results}
    # Both track them at 0.04 to 0.07 rad; people's walks at 0.06 to 0.09.
    assert {motion: error for motion, error in errors.items() if error > 0.08} == {}
