"""A minute by the clock: policies of others walk the G1 through the station as fast as in the loop that is not ours."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.assets import resolve
from tests.figures import Figures
from tests.main_job.velocity_runs import FIGURES_WITHIN, HOLOSOMA, Velocity, expect_figures, expect_sound, walk
from tests.verdicts import OF_A_LATE_MACHINE

FIGURES: dict[str, dict[Velocity, Velocity]] = {
    "holosoma": {
        (0.0, 0.0, 0.0): (0.00, 0.00, 0.02),
        (0.5, 0.0, 0.0): (0.42, -0.02, 0.02),
        (0.0, 0.4, 0.0): (-0.03, 0.19, -0.02),
        (0.0, 0.0, 0.8): (-0.02, -0.03, 0.71),
        (-0.5, 0.0, 0.0): (-0.41, -0.01, -0.01),
    },
    "playground-g1": {
        (0.0, 0.0, 0.0): (0.14, -0.02, 0.08),
        (-0.5, 0.0, 0.0): (-0.25, -0.04, 0.06),
    },
    "deploy-yaml": {(0.0, 0.0, 0.0): (0.00, 0.00, 0.00), (0.5, 0.0, 0.0): (0.45, 0.00, 0.00)},
    "falcon": {(0.0, 0.0, 0.0): (0.00, 0.00, 0.00), (0.5, 0.0, 0.0): (0.47, -0.02, 0.06)},
}
"""Measured velocity by the commanded one, in a bare loop of the same policy and another model of the robot.

Of falcon the other loop says the first number alone; the two beside it are of this station without its processes. How
fast the second one turns is no figure to compare: asked for 0.8 rad/s it makes 0.39 to 0.6, by the floor, by the shape
of its feet and by the time step (0.51 in the bare loop).
"""

CHECKPOINTS = {
    "holosoma": HOLOSOMA,
    "playground-g1": "zoo:policies/playground_g1_policy.onnx",
    "deploy-yaml": "zoo:policies/unitree_rl_mjlab_g1/deploy.yaml",
    "falcon": "zoo:policies/falcon_g1_29dof.onnx",
}
OF_THE_LEGS = ("motion.robot=g1_29_legs", "motion.format=velocity-posture")


OTHER_ROBOTS: dict[str, tuple[str, str, dict[Velocity, Velocity]]] = {
    "go2": ("pilla-go2", "pilla_go2_policy.jit", {
        (0.0, 0.0, 0.0): (0.00, 0.01, -0.01), (0.5, 0.0, 0.0): (0.50, 0.01, -0.02),
        (0.0, 0.4, 0.0): (0.01, 0.38, 0.02), (0.0, 0.0, 0.5): (0.03, 0.00, 0.49),
        (-0.5, 0.0, 0.0): (-0.46, 0.00, 0.01),
    }),
    "go1": ("playground-go1", "playground_go1_policy.onnx", {(0.0, 0.0, 0.0): (0.00, 0.00, 0.00)}),
    "g1_12": ("rlgym-g1", "rlgym_g1_motion.pt", {
        (0.0, 0.0, 0.0): (0.01, -0.01, -0.01), (0.5, 0.0, 0.0): (0.48, 0.00, -0.01),
        (0.0, 0.0, 0.8): (0.02, -0.02, 0.75),
    }),
    "h1_10": ("rlgym-h1", "rlgym_h1_motion.pt", {
        (0.0, 0.0, 0.0): (-0.08, 0.02, -0.02), (0.5, 0.0, 0.0): (0.43, 0.03, -0.01),
        (0.0, 0.0, 0.8): (-0.07, 0.06, 0.71),
    }),
    "h1_2_12": ("rlgym-h1-2", "rlgym_h1_2_motion.pt", {
        (0.0, 0.0, 0.0): (0.02, 0.02, 0.04), (0.5, 0.0, 0.0): (0.49, 0.00, 0.03),
        (0.0, 0.0, 0.8): (0.01, 0.00, 0.72),
    }),
}  # fmt: skip
"""By robot: policy, its file, and what was measured in a bare loop, where the script asks for the same velocities."""


def slippery(folder: Path) -> str:
    """Return a setting of the robot: our model on the floor that the second policy was trained and measured on.

    With our friction of 1 it falls in three of 25 such minutes, when it is sent backwards; with 0.6 in none of 25.
    """
    text = resolve("builtin:g1.xml").read_text(encoding="utf-8")
    changed = text.replace('priority="1" friction="1"', 'priority="1" friction="0.6"')
    assert changed != text
    (folder / "g1.xml").write_text(changed, encoding="utf-8")
    return f"robot.robot_options.model={folder / 'g1.xml'}"


@pytest.mark.assets
@pytest.mark.timeout(400)
@pytest.mark.parametrize("policy", FIGURES)
def test_in_a_minute_nobody_falls_and_velocities_are_those_of_a_bare_loop(
    policy: str, tmp_path: Path, processes: None, assets: Path, proof: Figures
) -> None:
    settings = {"playground-g1": (slippery(tmp_path),), "falcon": OF_THE_LEGS}.get(policy, ())
    walked = walk(tmp_path / "station", "velocity:each-axis", *settings, policy=policy, checkpoint=CHECKPOINTS[policy])
    expect_sound(walked)
    assert walked.steps["steps"] >= 60 * 50
    assert {reason["rule"] for reason in walked.check["reasons"]} <= OF_A_LATE_MACHINE, walked.check["reasons"]
    expect_figures(walked, FIGURES[policy])
    found = walked.measured()
    worst = max(abs(a - b) for asked, came in FIGURES[policy].items() for a, b in zip(found[asked], came, strict=True))
    proof.figure(
        f"a minute of velocities by {policy}: farthest from a bare loop", worst, limit=f"{FIGURES_WITHIN} m/s or rad/s"
    )


@pytest.mark.assets
@pytest.mark.timeout(400)
@pytest.mark.parametrize("robot", OTHER_ROBOTS)
def test_every_robot_walks_a_minute_by_its_policy_as_fast_as_in_a_bare_loop(
    robot: str, tmp_path: Path, processes: None, assets: Path, proof: Figures
) -> None:
    policy, file, figures = OTHER_ROBOTS[robot]
    walked = walk(tmp_path / "s", "velocity:each-axis", policy=policy, checkpoint=f"zoo:policies/{file}", robot=robot)
    expect_sound(walked)
    assert walked.steps["steps"] >= 60 * 50
    assert {reason["rule"] for reason in walked.check["reasons"]} <= OF_A_LATE_MACHINE, walked.check["reasons"]
    expect_figures(walked, figures)
    found = walked.measured()
    worst = max(abs(a - b) for asked, came in figures.items() for a, b in zip(found[asked], came, strict=True))
    what = f"a minute of velocities, {robot} by {policy}: farthest from a bare loop"
    proof.figure(what, worst, limit=f"{FIGURES_WITHIN} m/s or rad/s")
