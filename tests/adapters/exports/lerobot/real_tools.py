"""Edit a data set with LeRobot's own tools and train on it, in an environment of its own; run by hand, no part of the
tests.

    python tests/adapters/exports/lerobot/real_tools.py SET --env FOLDER [--steps 100]

FOLDER is the environment that `real_loader.py` made for v3.0, with ``pip install 'lerobot[training]==0.6.1'`` in it
for the training. SET has two episodes or more. The commands are `lerobot-edit-dataset` (info, split, merge, delete) and
`lerobot-train` with a small ACT without downloaded weights, on the CPU. What they made is compared with SET, row by row
and with a picture at either end of each episode; the exit code is 1 where something differs, or the loss did not fall.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

_SMALL_ACT = {
    "type": "act", "device": "cpu", "push_to_hub": "false", "pretrained_backbone_weights": "null", "dim_model": "128",
    "dim_feedforward": "256", "n_heads": "4", "n_encoder_layers": "2", "n_vae_encoder_layers": "2", "chunk_size": "20",
    "n_action_steps": "20",
}  # fmt: skip
_OFFLINE = {"HF_HUB_OFFLINE": "1", "CUDA_VISIBLE_DEVICES": ""}


def main() -> int:
    """Run LeRobot's commands, compare, and train."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path, help="folder that `station export lerobot` made, v3.0")
    parser.add_argument("--env", type=Path, help="environment with LeRobot 0.6.1")
    parser.add_argument("--steps", type=int, default=100, help="of the training; 0 for none  [default: 100]")
    parser.add_argument("--same", type=Path, help=argparse.SUPPRESS)  # inside the environment
    parser.add_argument("--episodes", default="", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    root = asked.dataset.absolute()
    if asked.same is not None:
        return same(root, asked.same, [int(number) for number in asked.episodes.split(",")])
    if asked.env is None:
        parser.error("--env is missing: the folder of an environment with LeRobot")
    tools = asked.env.absolute() / "bin"
    with tempfile.TemporaryDirectory(prefix="real-tools-") as name:
        return max(edited(tools, root, Path(name)), trained(tools, root, Path(name), asked.steps) if asked.steps else 0)


def edited(tools: Path, root: Path, folder: Path) -> int:
    """Split, merge and delete, and compare each result with the data set."""

    def edit(operation: str, *words: str) -> str:
        asked = ["--repo_id=station/export", f"--root={root}"] if operation != "merge" else []
        return run([str(tools / "lerobot-edit-dataset"), *asked, f"--operation.type={operation}", *words])

    def compared(other: Path, numbers: list[int]) -> int:
        inside = [str(tools / "python"), __file__, str(root), "--same", str(other), "--episodes"]
        sys.stdout.flush()
        return subprocess.run([*inside, ",".join(map(str, numbers))], check=False, env=os.environ | _OFFLINE).returncode

    told = edit("info")
    say("; ".join(line.strip() for line in told.splitlines() if re.match(r"(Total|FPS|Average)", line)))
    count = int(re.findall(r"Total episode: (\d+)", told)[0])
    rest = list(range(1, count))
    parts, merged, less = folder / "parts", folder / "merged", folder / "less"
    edit("split", f"--new_root={parts}", f'--operation.splits={{"first": [0], "rest": {rest}}}')
    roots = [str(parts / "first"), str(parts / "rest")]
    edit("merge", "--new_repo_id=station/merged", f"--new_root={merged}",
         "--operation.repo_ids=['station/first', 'station/rest']", f"--operation.roots={roots}")  # fmt: skip
    edit("delete_episodes", "--new_repo_id=station/less", f"--new_root={less}", "--operation.episode_indices=[0]")
    return max(compared(parts / "first", [0]), compared(merged, [0, *rest]), compared(less, rest))


def trained(tools: Path, root: Path, folder: Path, steps: int) -> int:
    """Train a small ACT, and say how its loss went."""
    words = [f"--policy.{name}={value}" for name, value in _SMALL_ACT.items()]
    every = max(1, steps // 10)
    told = run([
        str(tools / "lerobot-train"), "--dataset.repo_id=station/export", f"--dataset.root={root}",
        "--dataset.video_backend=pyav", *words, "--batch_size=4", f"--steps={steps}", f"--log_freq={every}",
        "--num_workers=0", "--save_checkpoint=false", "--wandb.enable=false", f"--output_dir={folder / 'trained'}",
    ])  # fmt: skip
    losses = [float(value) for value in re.findall(r"\bloss:([\d.]+)", told)]
    say(f"ACT, {steps} steps: loss {' '.join(f'{loss:g}' for loss in losses)}")
    return 0 if losses and losses[-1] < losses[0] else 1


def run(words: list[str]) -> str:
    """Run a command of LeRobot's; return all that it printed."""
    done = subprocess.run(
        words, check=False, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=os.environ | _OFFLINE
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(words)}\n{done.stdout[-3000:]}\nended with {done.returncode}")
    return done.stdout


def same(root: Path, other: Path, numbers: list[int]) -> int:
    """Whether a data set has some episodes of another one, in this order: all numbers of all rows, and pictures."""
    import importlib

    torch: Any = importlib.import_module("torch")
    datasets: Any = importlib.import_module("lerobot.datasets.lerobot_dataset")
    ours, theirs = (
        datasets.LeRobotDataset("station/export", root=folder, video_backend="pyav") for folder in (root, other)
    )
    begins = list(ours.meta.episodes["dataset_from_index"]), list(theirs.meta.episodes["dataset_from_index"])
    lengths = list(ours.meta.episodes["length"])
    cameras, rows, worst, different = ours.meta.camera_keys, 0, 0.0, set()
    tables = [each.hf_dataset.with_format("numpy") for each in (ours, theirs)]
    own = {"index", "episode_index"}
    for place, number in enumerate(numbers):
        mine, its, length = begins[0][number], begins[1][place], lengths[number]
        parts = [tables[0][mine : mine + length], tables[1][its : its + length]]
        different |= {name for name in parts[0] if name not in own and (parts[0][name] != parts[1][name]).any()}
        rows += length
        for row in (0, length - 1):
            one, two = ours[mine + row], theirs[its + row]
            different |= {"task"} if one["task"] != two["task"] else set()
            worst = max([worst, *((one[camera] - two[camera]).abs().max().item() for camera in cameras)])
    assert torch.is_tensor(ours[0]["action"])
    is_same = not different and rows == theirs.meta.total_frames and worst == 0.0
    say(f"{other.name}: {theirs.meta.total_episodes} episodes, {theirs.meta.total_frames} rows; columns that differ: "
        f"{sorted(different) or 'none'}; pictures differ by {worst:g} at most")  # fmt: skip
    return 0 if is_same else 1


def say(line: str) -> None:
    """Print a line."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
