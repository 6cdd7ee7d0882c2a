"""A minute by the clock: policies of others walk the G1 through the station as fast as in the loop that is not ours."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.figures import Figures
from tests.main_job.velocity_runs import FIGURES_WITHIN, HOLOSOMA, Velocity, expect_figures, expect_sound, walk
from tests.verdicts import OF_A_LATE_BUS

FIGURES: dict[str, dict[Velocity, Velocity]] = {
    "holosoma": {
        (0.0, 0.0, 0.0): (0.00, 0.00, 0.02),
        (0.5, 0.0, 0.0): (0.42, -0.02, 0.02),
        (0.0, 0.4, 0.0): (-0.03, 0.19, -0.02),
        (0.0, 0.0, 0.8): (-0.02, -0.03, 0.71),
        (-0.5, 0.0, 0.0): (-0.41, -0.01, -0.01),
    },
}
"""Measured velocity by the commanded one, in a bare loop of the same policy and another model of the robot."""

CHECKPOINTS = {"holosoma": HOLOSOMA}


@pytest.mark.assets
@pytest.mark.timeout(400)
@pytest.mark.parametrize("policy", FIGURES)
def test_in_a_minute_nobody_falls_and_velocities_are_those_of_a_bare_loop(
    policy: str, tmp_path: Path, processes: None, assets: Path, proof: Figures
) -> None:
    walked = walk(tmp_path, "velocity:each-axis", policy=policy, checkpoint=CHECKPOINTS[policy])
    expect_sound(walked)
    assert walked.steps["steps"] >= 60 * 50
    assert {reason["rule"] for reason in walked.check["reasons"]} <= OF_A_LATE_BUS, walked.check["reasons"]
    expect_figures(walked, FIGURES[policy])
    found = walked.measured()
    worst = max(abs(a - b) for asked, came in FIGURES[policy].items() for a, b in zip(found[asked], came, strict=True))
    proof.figure(
        f"a minute of velocities by {policy}: farthest from a bare loop", worst, limit=f"{FIGURES_WITHIN} m/s or rad/s"
    )
