"""The figures of an episode that every version must find again: of its check, audit, replay and export."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from adapters.exports.kinds import LEROBOT
from adapters.exports.lerobot.kind import LeRobotOptions
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.episode.replaying.arm_audit import audit_arm
from station.episode.replaying.audit import audit
from station.episode.replaying.resimulate import to_sim
from station.export.kind import Source
from station.export.run import Workers, export
from tests.adapters.exports.quick_looks import converted

_NOT_OF_THE_EPISODE = (
    "rules", "seconds", "speed_x_realtime", "checkpoint", "runtime", "recorded_runtime", "notes", "verdict_by",
)  # fmt: skip


def figures(episode: Path, out: Path) -> dict[str, Any]:
    """Return the figures of an episode; its folder is not changed.

    Args:
        episode: The episode.
        out: A folder for its exports.
    """
    reader = open_episode(episode)
    found: dict[str, Any] = {"check": _plain(check(reader))}
    for robot in {step["robot"] for step in found["check"]["steps"]}:
        if any(key.startswith("policy_obs_") for key in reader.topics()):
            found["audit"] = _plain(audit(reader, robot=robot))
            found["replay"] = _plain(to_sim(reader, robot=robot))
        else:
            found["audit"] = _plain(audit_arm(reader, robot))
    found["export"] = _tables(episode, out / "csv")
    found["data set"] = _data_set(episode, out / "lerobot")
    return found


def _plain(found: Any) -> dict[str, Any]:
    facts: dict[str, Any] = msgspec.to_builtins(found)
    return {name: value for name, value in facts.items() if name not in _NOT_OF_THE_EPISODE}


def _tables(episode: Path, out: Path) -> dict[str, dict[str, list[float]]]:
    """Rows, mean and root mean square of each column of each table of the export to CSV."""
    out.parent.mkdir(exist_ok=True)
    converted("csv", episode, out)
    found: dict[str, dict[str, list[float]]] = {}
    for path in sorted((out / episode.name).glob("*.csv")):
        with path.open(encoding="utf-8", newline="") as file:
            title, *rows = list(csv.reader(file))
        values = np.array(rows, dtype=np.float64)
        found[path.stem] = {
            name: [len(values), float(column.mean()), math.sqrt(float(np.square(column).mean()))]
            for name, column in zip(title, values.T, strict=True)
        }
    return found


def _data_set(episode: Path, out: Path) -> dict[str, Any]:
    """Frames of the export to LeRobot, and shape and names of each of its features."""
    source = Source(episode_id=episode.name, folder=str(episode))
    # What version 0.1 had no choice of: 50 rows a second whatever the cameras have, and all rows that can be made.
    options = LeRobotOptions(min_quality="any", fps=50, trim="none")
    export(LEROBOT, [source], options, out, where=Workers(jobs=1))
    info = json.loads((out / "meta/info.json").read_text(encoding="utf-8"))
    features = {name: {"shape": one["shape"], "names": one["names"]} for name, one in info["features"].items()}
    return {"frames": info["total_frames"], "fps": info["fps"], "features": features}
