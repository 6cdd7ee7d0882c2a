"""``python -m adapters.policies.tracker.training``: train the tracker. Needs the extra ``train`` and upstream data."""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from adapters.policies.tracker.training.recipe import Recipe
from station import assets
from station.errors import BadFile, StationError

if TYPE_CHECKING:
    from adapters.policies.tracker.training.collector import Score
    from adapters.policies.tracker.training.dagger import Round

_ROBOT_MODEL = Path(__file__).parents[3] / "robots" / "g1" / "g1.xml"


def main(arguments: list[str] | None = None) -> int:
    """Train and write ``tracker.onnx`` and ``training.json`` into a folder; return the exit code."""
    parsed = _parser().parse_args(arguments)
    try:
        recipe = _recipe(parsed.recipe)
        _run(recipe, parsed.out, parsed.threads, parsed.device)
    except StationError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    except KeyboardInterrupt:
        sys.stderr.write("stopped; nothing was written that is not whole\n")
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m adapters.policies.tracker.training", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="Folder for the network and the log.")
    parser.add_argument("--recipe", type=Path, help="YAML with what differs from the recipe in recipe.py.")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1, help="Threads of simulation and learning.")
    parser.add_argument("--device", default=None, help="cpu or cuda.  [default: cuda when there is one]")
    return parser


def _recipe(path: Path | None) -> Recipe:
    if path is None:
        return Recipe()
    try:
        return msgspec.yaml.decode(path.read_bytes(), type=Recipe)
    except (OSError, msgspec.DecodeError) as error:
        raise BadFile(f"{path}: not a recipe: {error}") from error


def _run(recipe: Recipe, out: Path, threads: int, device: str | None) -> None:
    torch = _torch()
    from adapters.policies.tracker.training.collector import Collector
    from adapters.policies.tracker.training.crowd import Crowd
    from adapters.policies.tracker.training.dagger import Learner, train
    from adapters.policies.tracker.training.network import save_onnx
    from adapters.policies.tracker.training.streams import Streams
    from adapters.policies.tracker.training.tutor import Network, Tutor
    from adapters.policies.twist2 import WRIST_GAINS, gains

    torch.set_num_threads(threads)
    out.mkdir(parents=True, exist_ok=True)
    teacher_path = assets.resolve(recipe.teacher)
    models = [_ROBOT_MODEL] + ([assets.resolve(recipe.meshed_model)] if recipe.meshed_model else [])
    rng = np.random.default_rng(recipe.seed)
    kp, kd = gains(*WRIST_GAINS["sim"])
    crowd = Crowd(models, kp, kd, recipe.crowd, rng, threads)
    tutor = Tutor(Network(teacher_path, threads), len(crowd), recipe.calm, kp, kd)
    collector = Collector(crowd, tutor, Streams(recipe), recipe, rng)
    learner = Learner(recipe, device or ("cuda" if torch.cuda.is_available() else "cpu"))
    facts = {"seed": str(recipe.seed), "teacher_sha256": assets.sha256(teacher_path), "licence": "Apache-2.0"}
    log: list[dict[str, Any]] = []

    def on_round(done: Round) -> None:
        log.append(_logged(done))
        _say(done, recipe)
        save_onnx(learner.average, out / "tracker.onnx.part", facts)
        (out / "tracker.onnx.part").replace(out / "tracker.onnx")
        _write_log(out / "training.json", recipe, facts, log)

    try:
        train(recipe, learner, collector, on_round)
    finally:
        crowd.close()


def _torch() -> Any:
    try:
        import onnx
        import torch
    except ImportError as error:
        raise StationError(f"{error}; training needs more: pip install 'teleop-station[train]'") from error
    del onnx
    return torch


def _write_log(path: Path, recipe: Recipe, facts: dict[str, str], log: list[dict[str, Any]]) -> None:
    """Write it with a round per line: a person scrolls through it, and a diff shows what changed."""
    head = json.dumps({"recipe": msgspec.to_builtins(recipe), "facts": facts})
    rounds = ",\n".join(json.dumps(entry, separators=(",", ":")) for entry in log)
    path.write_text(f'{head[:-1]}, "rounds": [\n{rounds}\n]}}\n', encoding="utf-8")


def _logged(done: Round) -> dict[str, Any]:
    return {
        "round": done.number,
        "loss": round(done.loss, 5),
        "elapsed_s": round(done.elapsed_s, 1),
        "student": _scored(done.student),
        "teacher": _scored(done.teacher),
    }


def _scored(score: Score) -> dict[str, Any]:
    return {
        kind: {
            "steps": steps,
            "falls": score.falls[kind],
            "mean_joint_error_rad": round(score.error[kind] / steps, 4),
        }
        for kind, steps in sorted(score.steps.items())
    }


def _say(done: Round, recipe: Recipe) -> None:
    lines = [f"round {done.number}/{recipe.rounds}  loss {done.loss:.4f}  {done.elapsed_s / 60:.1f} min"]
    for name in ("student", "teacher"):
        score = getattr(done, name)
        if score.steps:
            lines.append(f"  {name}: {score.told()}")
    sys.stderr.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    raise SystemExit(main())
