"""``python -m research.tracker``: train the tracker. Needs the extra ``train`` and upstream data."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from research import run
from research.tracker.recipe import Recipe
from station import assets

_ROBOT_MODEL = Path(__file__).parents[2] / "adapters" / "robots" / "g1" / "g1.xml"


def main(arguments: list[str] | None = None) -> int:
    """Train and write ``tracker.onnx`` and ``training.json`` into a folder; return the exit code."""
    return run.main("python -m research.tracker", "tracker", Recipe, _make, arguments, __doc__)


def _make(recipe: Recipe, rng: np.random.Generator, threads: int) -> run.Made:
    from adapters.policies.twist2 import WRIST_GAINS, gains
    from adapters.robots.legged.unitree import G1
    from research.crowd import Crowd
    from research.teacher import Network
    from research.tracker.streams import Streams
    from research.tracker.task import TrackerTask
    from research.tracker.tutor import Tutor

    teacher = assets.resolve(recipe.teacher)
    models = [_ROBOT_MODEL] + ([assets.resolve(recipe.meshed_model)] if recipe.meshed_model else [])
    kp, kd = gains(*WRIST_GAINS["sim"])
    crowd = Crowd(G1, models, kp, kd, recipe.crowd, rng, threads, trunk="torso_link")
    tutor = Tutor(Network(teacher, threads), len(crowd), recipe.calm, kp, kd)
    return run.Made(crowd, TrackerTask(tutor, Streams(recipe)), {"teacher_sha256": assets.sha256(teacher)})


if __name__ == "__main__":
    raise SystemExit(main())
