"""From shards to what robomimic or ACT opens, with a page that says what stands where."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from adapters.exports.hdf5.arrays import arrays, described, picture_path
from adapters.exports.hdf5.episode import DEMO, SHARD
from adapters.exports.hdf5.h5py_library import create, h5py
from adapters.exports.hdf5.plan import Plan
from adapters.exports.lerobot import card
from adapters.exports.lerobot.dataset import TRAIN, VAL, notes, split
from adapters.exports.lerobot.layouts import write_json
from adapters.exports.lerobot_rows import page
from station.export.kind import Shard, SkippedEpisode
from station.export.shards import place

FILE = "dataset.hdf5"

_ABOUT_DEPTH = (
    "",
    "Depth is in steps, not in 0 to 1, to which robomimic cuts what it is given as depth: set a processor of its "
    "depth modality that multiplies with the attribute `step` (metres) and scales what a network shall see.",
)

_GYM = 2  # the kind of an environment that robomimic does not have to know; none is to be made of it
_PARTS = {TRAIN: "train", VAL: "valid"}  # as robomimic calls them


def join(shards: Sequence[Shard], left_out: Sequence[SkippedEpisode], plan: Plan, folder: Path) -> dict[str, Any]:
    """Make the result of shards, one of them open at a time.

    Raises:
        OSError: the disk refuses.
    """
    parts = split(shards, plan.rows.val, plan.rows.seed)
    ordered = [shard for part in parts.values() for shard in part]
    if plan.layout == "robomimic":
        _one_file(parts, plan, folder / FILE)
    else:
        for number, shard in enumerate(ordered):
            place(shard.folder / SHARD, folder / f"episode_{number}.hdf5")
    named = {_PARTS[name]: [shard.source.episode_id for shard in part] for name, part in parts.items()}
    write_json(
        folder / "station.json",
        {
            **card.provenance(ordered, left_out, plan.rows),
            "layout": plan.layout,
            "encoding": plan.encoding,
            "splits": named,
        },
    )
    what = f"HDF5 as {'robomimic' if plan.layout == 'robomimic' else 'ACT'} reads it"
    how = _robomimic(plan) if plan.layout == "robomimic" else _act(plan)
    text = page(what, how, described(plan), ordered, left_out, plan.rows)
    (folder / "README.md").write_text(text, encoding="utf-8")
    return {
        "rows": sum(shard.made.rows for shard in ordered),
        "layout": plan.layout,
        "cameras": [camera.name for camera in plan.rows.common.pictures],
        "notes": list(notes(ordered, plan.rows)),
    }


def _one_file(parts: dict[str, list[Shard]], plan: Plan, target: Path) -> None:
    """Write the file that robomimic opens: ``data/demo_N`` of each episode, and which are for what in ``mask``."""
    with create(target) as file:
        data, count, rows = file.create_group("data"), 0, 0
        for part, shards in parts.items():
            names = []
            for shard in shards:
                names.append(f"demo_{count}")
                with h5py.File(shard.folder / SHARD, "r") as made:
                    made.copy(DEMO, data, name=names[-1])
                count, rows = count + 1, rows + shard.made.rows
            if names:
                file[f"mask/{_PARTS[part]}"] = np.array(names, dtype="S")
        robot = plan.rows.common.robot or "unknown"
        data.attrs["total"] = rows
        data.attrs["env_args"] = json.dumps({"env_name": robot, "type": _GYM, "env_kwargs": {}})


def _robomimic(plan: Plan) -> list[str]:
    low = [one.path.removeprefix("obs/") for one in arrays(plan) if not one.is_action]
    pictures = [picture_path(plan, camera).removeprefix("obs/") for camera in plan.rows.common.cameras]
    depths = [picture_path(plan, camera).removeprefix("obs/") for camera in plan.rows.common.depths]
    modalities = {"low_dim": low, "rgb": pictures, "depth": depths, "scan": []}
    config = {
        "train": {"data": FILE, "hdf5_filter_key": "train", "hdf5_load_next_obs": False},
        "experiment": {"rollout": {"enabled": False}},
        "observation": {"modalities": {"obs": modalities}},
    }
    return [
        "In the configuration of a training run. Numbers are as recorded, in their own units: `hdf5_normalize_obs` "
        "normalises observations, `action_config` (robomimic 0.5) actions; an older one learns actions in -1 to 1.",
        "",
        "```json",
        json.dumps(config, indent=2),
        "```",
        *(_ABOUT_DEPTH if depths else ()),
    ]


def _act(plan: Plan) -> list[str]:
    common = plan.rows.common
    widths = {one.path: len(one.names) for one in arrays(plan)}
    names = ", ".join(camera.name for camera in common.cameras) or "none"
    told = [
        f"State dimension {widths['observations/qpos']}, action dimension {widths['action']}, cameras: {names}. `sim` "
        "is true whatever the robot was: where it is false, ACT's loader shifts the actions by a row, which is right "
        "for recordings of ALOHA alone.",
    ]
    if plan.encoding == "jpeg" and common.cameras:
        told += [
            "",
            "Pictures are JPEG files (`compress` is true), the camera's own but of compacted episodes, row by row, "
            "with zeros behind each; `compress_len` has their lengths, cameras in the order of above. OpenCV decodes "
            "them to BGR: what hands them to a network as they come, as act-plus-plus does, must see BGR from the "
            "robot too, or be exported with `--encoding rgb`.",
        ]
    return told
