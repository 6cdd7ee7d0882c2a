"""The command line of a training run: recipe, progress, log, and a network that is whole after each round."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import msgspec
import numpy as np

from research.recipe import Run
from station.errors import BadFile, StationError

if TYPE_CHECKING:
    from research.collector import Score, Task
    from research.crowd import Crowd
    from research.learner import Round

Recipe = TypeVar("Recipe", bound=Run)


class Made(NamedTuple):
    """What a recipe asks for: the robots, what they learn, and facts about it for the file."""

    crowd: Crowd
    task: Task
    facts: dict[str, str]


def main(
    program: str,
    name: str,
    recipe: type[Recipe],
    make: Callable[[Recipe, np.random.Generator, int], Made],
    arguments: list[str] | None,
    about: str | None,
) -> int:
    """Train and write a network and ``training.json`` into a folder; return the exit code.

    Args:
        program: What is typed to run it.
        name: Of the network's file, without ``.onnx``.
        recipe: The recipe's type; its defaults are the recipe without a file.
        make: Returns robots and task of a recipe, a generator, and a number of threads.
        arguments: Of the command line; None for the process's.
        about: For the help.
    """
    parser = argparse.ArgumentParser(program, description=about)
    parser.add_argument("--out", type=Path, required=True, help="Folder for the network and the log.")
    parser.add_argument("--recipe", type=Path, help="YAML with what differs from the recipe in recipe.py.")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1, help="Threads of simulation and learning.")
    parser.add_argument("--device", default=None, help="cpu or cuda.  [default: cuda when there is one]")
    parsed = parser.parse_args(arguments)
    try:
        asked = _read(parsed.recipe, recipe)
        _run(name, asked, make, parsed.out, parsed.threads, parsed.device)
    except StationError as error:
        sys.stderr.write(f"error: {error}\n")
        return 2
    except KeyboardInterrupt:
        sys.stderr.write("stopped; nothing was written that is not whole\n")
        return 130
    return 0


def _read(path: Path | None, recipe: type[Recipe]) -> Recipe:
    if path is None:
        return recipe()
    try:
        return msgspec.yaml.decode(path.read_bytes(), type=recipe)
    except OSError as error:
        raise BadFile(f"{path}: {error.strerror}; expected a recipe, a YAML file") from error
    except msgspec.DecodeError as error:
        raise BadFile(f"{path}: not a recipe: {error}") from error


def _run(
    name: str,
    recipe: Recipe,
    make: Callable[[Recipe, np.random.Generator, int], Made],
    out: Path,
    threads: int,
    device: str | None,
) -> None:
    torch = _torch()
    from research.collector import Collector
    from research.learner import Learner, train
    from research.network import save_onnx

    torch.set_num_threads(threads)
    out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(recipe.seed)
    crowd, task, more = make(recipe, rng, threads)
    collector = Collector(crowd, task, recipe.crowd, rng)
    device = device or ("cuda" if torch.cuda.is_available() else "cpu")
    learner = Learner(recipe, device, task.frames * task.frame, task.actions)
    facts = {"seed": str(recipe.seed), **more, "licence": "Apache-2.0"}
    log: list[dict[str, Any]] = []

    def on_round(done: Round) -> None:
        log.append(_logged(done, task.error))
        _say(done, recipe)
        save_onnx(learner.average, out / f"{name}.onnx.part", facts)
        (out / f"{name}.onnx.part").replace(out / f"{name}.onnx")
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


def _write_log(path: Path, recipe: Run, facts: dict[str, str], log: list[dict[str, Any]]) -> None:
    """Write it with a round per line: a person scrolls through it, and a diff shows what changed."""
    head = json.dumps({"recipe": msgspec.to_builtins(recipe), "facts": facts})
    rounds = ",\n".join(json.dumps(entry, separators=(",", ":")) for entry in log)
    path.write_text(f'{head[:-1]}, "rounds": [\n{rounds}\n]}}\n', encoding="utf-8")


def _logged(done: Round, error: str) -> dict[str, Any]:
    return {
        "round": done.number,
        "loss": round(done.loss, 5),
        "elapsed_s": round(done.elapsed_s, 1),
        "student": _scored(done.student, error),
        "teacher": _scored(done.teacher, error),
    }


def _scored(score: Score, error: str) -> dict[str, Any]:
    return {
        kind: {"steps": steps, "falls": score.falls[kind], error: round(score.error[kind] / steps, 4)}
        for kind, steps in sorted(score.steps.items())
    }


def _say(done: Round, recipe: Run) -> None:
    lines = [f"round {done.number}/{recipe.rounds}  loss {done.loss:.4f}  {done.elapsed_s / 60:.1f} min"]
    for name in ("student", "teacher"):
        score = getattr(done, name)
        if score.steps:
            lines.append(f"  {name}: {score.told()}")
    sys.stderr.write("\n".join(lines) + "\n")
