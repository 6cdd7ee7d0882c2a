"""Open a data set with the real LeRobot, in an environment of its own; no part of the tests, run by hand.

    python tests/adapters/exports/lerobot/real_loader.py SET --env FOLDER [--python python3.12]

LeRobot pins older releases of torch, numpy and PyAV than the station uses, so the two cannot share an environment.
FOLDER gets a virtual environment with it (5.4 GB, minutes), or is used when it has one. What is printed was read by
LeRobot alone: by the newest release for v3.0, for v2.1 by the last one that reads it, whose loader openpi has.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

RELEASES = {"v3.0": ("lerobot[dataset]==0.6.1", "python3.12"), "v2.1": ("lerobot==0.3.3", "python3.11")}
"""What reads a layout, and a Python that it runs on."""


def main() -> int:
    """Make the environment where there is none, and look at the data set in it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path, help="folder that `station export lerobot` made")
    parser.add_argument("--env", type=Path, help="folder of the environment; made when it is not there")
    parser.add_argument("--python", help="for a new environment; 3.12 for v3.0, 3.11 for v2.1 unless it is given")
    asked = parser.parse_args()
    if asked.env is None:
        return look(asked.dataset.absolute())
    inside = asked.env / "bin/python"
    release, python = RELEASES[json.loads((asked.dataset / "meta/info.json").read_text())["codebase_version"]]
    if not inside.exists():
        subprocess.run([asked.python or python, "-m", "venv", str(asked.env)], check=True)
        subprocess.run([str(inside), "-m", "pip", "install", release], check=True)
    return subprocess.run([str(inside), __file__, str(asked.dataset)], check=False).returncode


def look(root: Path) -> int:
    """Load everything that a training run loads, and print what came."""
    import importlib
    from importlib.metadata import version

    torch: Any = importlib.import_module("torch")
    datasets: Any = importlib.import_module("lerobot.datasets.lerobot_dataset")
    say(f"lerobot {version('lerobot')}, torch {torch.__version__}, Python {sys.version.split()[0]}")
    dataset = datasets.LeRobotDataset("station/export", root=root, video_backend="pyav")
    meta = dataset.meta
    say(f"{meta.total_episodes} episodes, {meta.total_frames} rows at {meta.fps} Hz, {meta.robot_type}")
    splits = meta.info["splits"] if isinstance(meta.info, dict) else meta.info.splits
    tasks = list(meta.tasks.values()) if isinstance(meta.tasks, dict) else list(meta.tasks.index)
    say(f"splits {splits}; tasks {tasks}")
    row = dataset[len(dataset) // 2]
    for name in sorted(row):
        value = row[name]
        shape = (
            f"{str(value.dtype).removeprefix('torch.')} {tuple(value.shape)}" if torch.is_tensor(value) else repr(value)
        )
        say(f"  {name}: {shape}")
    steps = {"action": [k / meta.fps for k in range(16)]}
    cameras = {name: [-1 / meta.fps, 0.0] for name in meta.camera_keys}
    windows = datasets.LeRobotDataset(
        "station/export", root=root, video_backend="pyav", delta_timestamps={**steps, **cameras}
    )
    batch = next(iter(torch.utils.data.DataLoader(windows, batch_size=8, shuffle=True)))
    say("windows in a batch of 8: " + ", ".join(f"{name} {tuple(batch[name].shape)}" for name in (*steps, *cameras)))
    shift = (torch.stack([dataset[k]["timestamp"] for k in (0, 1)]).diff() * meta.fps).item()
    say(f"rows are {shift:.3f} periods apart; statistics of {len(meta.stats)} columns, quantiles "
        f"{'q01' in meta.stats['observation.state']}")  # fmt: skip
    by_torchcodec(datasets, dataset, root)
    if hasattr(meta.episodes, "column_names"):  # v3.0
        say("of each episode: " + ", ".join(name for name in meta.episodes.column_names if "/" not in name))
    found = policy_features(meta.features)
    say("as inputs and outputs of a policy: " + ", ".join(f"{k} {f.type.name}" for k, f in found.items()))
    return 0


def by_torchcodec(datasets: Any, by_pyav: Any, root: Path) -> None:
    """Compare some pictures with those of the other decoder, which needs a system's FFmpeg libraries."""
    import importlib.util

    if importlib.util.find_spec("torchcodec") is None or not by_pyav.meta.camera_keys:
        return
    other = datasets.LeRobotDataset("station/export", root=root, video_backend="torchcodec")
    rows = [round(k * (len(other) - 1) / 9) for k in range(10)]
    differ = [
        (by_pyav[row][name] - other[row][name]).abs().max().item() for row in rows for name in other.meta.camera_keys
    ]
    say(f"pictures of {len(rows)} rows by torchcodec differ from PyAV's by {max(differ):.4f} of 1 at most")


def policy_features(features: Any) -> dict[str, Any]:
    """Return what LeRobot takes for inputs and outputs of a policy."""
    import importlib

    for name in ("lerobot.utils.feature_utils", "lerobot.datasets.utils"):  # where it is, and where it was
        try:
            found: Any = importlib.import_module(name).dataset_to_policy_features(features)
        except (ModuleNotFoundError, AttributeError):
            continue
        return dict(found)
    raise SystemExit("this LeRobot does not say what it takes for inputs and outputs of a policy")


def say(line: str) -> None:
    """Print a line."""
    sys.stdout.write(line + "\n")


if __name__ == "__main__":
    sys.exit(main())
