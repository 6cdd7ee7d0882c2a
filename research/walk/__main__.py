"""``python -m research.walk --recipe research/walk/go2.yaml``: train a policy that follows velocities.

Needs the extra ``train``, and the teacher's file, which the recipe names.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from research import run
from research.walk.recipe import Recipe
from station import assets
from station.errors import AssetMissing, BadFile, ConfigError


def main(arguments: list[str] | None = None) -> int:
    """Train and write ``walk.onnx`` and ``training.json`` into a folder; return the exit code."""
    return run.main("python -m research.walk", "walk", Recipe, _make, arguments, __doc__)


def _make(recipe: Recipe, rng: np.random.Generator, threads: int) -> run.Made:
    from adapters.policies.falcon import FalconPolicy
    from adapters.policies.playground import PlaygroundGo1Policy
    from adapters.policies.walk.policy import G1WalkPolicy, Go2WalkPolicy
    from adapters.robots.legged.unitree import G1, GO2
    from research.crowd import Crowd
    from research.teacher import Network
    from research.walk.task import Teacher, WalkTask
    from research.walk.teachers import FalconTeacher, Go1Teacher

    is_g1 = recipe.robot == "g1"
    file = _teachers_file(recipe.teacher, FalconPolicy.ORIGIN if is_g1 else PlaygroundGo1Policy.ORIGIN)
    network = Network(file, threads)
    policy, robot = (G1WalkPolicy, G1) if is_g1 else (Go2WalkPolicy, GO2)
    teacher: Teacher = FalconTeacher(network, recipe.crowd.robots) if is_g1 else Go1Teacher(network)
    trunk = "torso_link" if is_g1 else ""
    kp, kd = policy.GAINS
    crowd = Crowd(robot, [assets.resolve(robot.mjcf)], kp, kd, recipe.crowd, rng, threads, trunk)
    task = WalkTask(policy, teacher, recipe, robot.start_height_m)
    return run.Made(crowd, task, {"teacher_sha256": assets.sha256(file)})


def _teachers_file(reference: str, origin: str) -> Path:
    hint = f"name with `teacher` in the recipe a copy of {origin}"
    if not reference:
        raise ConfigError(f"the recipe names no teacher; {hint}")
    try:
        return assets.resolve(reference)
    except (AssetMissing, BadFile) as error:
        raise type(error)(f"{error}; {hint}") from None


if __name__ == "__main__":
    raise SystemExit(main())
