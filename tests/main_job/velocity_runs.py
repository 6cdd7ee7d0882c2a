"""A script of velocities through the whole station: the robot, its policy, and what its episode says of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tests.main_job.station_runs import ROOT, Terminal

RUNBOOK = "runbooks/g1-velocity-script.yaml"
FIGURES_WITHIN = 0.05  # [m/s], [rad/s]

HOLOSOMA = "zoo:policies/holosoma_fastsac_g1_29dof.onnx"

Velocity = tuple[float, float, float]


class Walked(NamedTuple):
    """What a run left behind."""

    terminal: Terminal
    script: str
    episode: str
    output: str
    check: dict[str, Any]
    audit: dict[str, Any]

    @property
    def steps(self) -> dict[str, Any]:
        """What the check says of the policy steps of the only robot."""
        (robot,) = self.check["steps"]
        return dict(robot)

    def measured(self) -> dict[Velocity, Velocity]:
        """Return the velocities that were measured, by what was commanded for a while."""
        return {tuple(each["commanded"]): tuple(each["measured"]) for each in self.steps["velocity"]["stretches"]}


def walk(
    folder: Path, script: str, *settings: str, policy: str = "holosoma", checkpoint: str = HOLOSOMA, robot: str = ""
) -> Walked:
    """Let a script walk the robot of the runbook, or another one by its name, recorded."""
    terminal, runbook = Terminal(folder), RUNBOOK
    if robot:
        text = (ROOT / RUNBOOK).read_text(encoding="utf-8").replace("g1_29", robot)
        runbook = str(folder / "script.yaml")
        Path(runbook).write_text(text.replace("g1-mujoco", f"{robot.replace('_', '-')}-mujoco"), encoding="utf-8")
    named = (f"robot.policy={policy}", f"robot.checkpoint={checkpoint}", f"motion.motion={script}", *settings)
    sets = [word for setting in named for word in ("--set", setting)]
    done = terminal.run("up", runbook, "--yes", "--record", "--task", "walk", *sets)
    output = done.stdout + done.stderr
    assert done.returncode == 0, output
    episode = str(terminal.episode("walk"))
    return Walked(terminal, script, episode, output, terminal.json("check", episode), terminal.json("audit", episode))


def expect_figures(walked: Walked, figures: dict[Velocity, Velocity]) -> None:
    """Compare measured velocities with those of a loop that is not ours."""
    found = walked.measured()
    for commanded, expected in figures.items():
        assert np.abs(np.subtract(found[commanded], expected)).max() <= FIGURES_WITHIN, (commanded, found[commanded])


def expect_sound(walked: Walked) -> None:
    """Nobody fell, and everything that the policy did is in the file."""
    check, audit = walked.check, walked.audit
    assert (check["falls"], check["resets"], check["estops"]) == (0, 0, 0), walked.output
    assert (check["dropped"], check["holes"], check["is_lossless"]) == (0, 0, True)
    assert audit["steps"] == walked.steps["steps"]
    assert (audit["different"], audit["observations"]["different"], audit["incomplete"]) == (0, 0, 0)
    assert (audit["commands"]["different"], audit["targets"]["different"]) == (0, 0)
    assert audit["observations"]["compared"] == audit["steps"]
