"""From shards to one buffer. Numbers are written anew; pictures, each a chunk, are copied as they were compressed."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from adapters.exports.lerobot import card
from adapters.exports.lerobot.dataset import notes
from adapters.exports.lerobot.layouts import write_json
from adapters.exports.lerobot_rows import page
from adapters.exports.zarr.arrays import create_numbers, create_pictures
from adapters.exports.zarr.episode import SHARD
from adapters.exports.zarr.plan import ACTION, DATA, ENDS, STATE, TIME, Plan, described, picture_name
from adapters.exports.zarr.zarr_library import FORMAT, zarr
from station.errors import EpisodeError
from station.export.kind import Shard, SkippedEpisode
from station.software import software

BUFFER = "replay_buffer.zarr"

_NO_DEPTH = "; it knows pictures in colour and numbers, and depth only in a task of your own"

Put = Callable[[str, bytes], None]
"""Adds a file of the buffer: its path in it, and what is in it."""

_WHEN = (1980, 1, 1, 0, 0, 0)  # of every file in a zip: the same shards give the same bytes


def join(shards: Sequence[Shard], left_out: Sequence[SkippedEpisode], plan: Plan, folder: Path) -> dict[str, Any]:
    """Make the buffer of shards, one of them in memory at a time.

    Raises:
        EpisodeError: a shard is not whole.
        OSError: the disk refuses.
    """
    buffer = folder / BUFFER
    _write_numbers(shards, plan, buffer)
    if plan.store == "folder":
        _copy_pictures(shards, plan, lambda name, data: _write(buffer / name, data))
    else:
        with zipfile.ZipFile(folder / f"{BUFFER}.zip", "x", zipfile.ZIP_STORED) as archive:
            for file in sorted(path for path in buffer.rglob("*") if path.is_file()):
                _add(archive, file.relative_to(buffer).as_posix(), file.read_bytes())
            _copy_pictures(shards, plan, lambda name, data: _add(archive, name, data))
        shutil.rmtree(buffer)
    told = {**card.provenance(shards, left_out, plan.rows), "store": plan.store}
    write_json(folder / "station.json", told)
    what = "A replay buffer as diffusion_policy and UMI read it (Zarr, format 2)"
    text = page(what, _how(plan), described(plan), shards, left_out, plan.rows)
    (folder / "README.md").write_text(text, encoding="utf-8")
    return {
        "rows": sum(shard.made.rows for shard in shards),
        "cameras": [camera.name for camera in plan.rows.common.pictures],
        "notes": list(notes(shards, plan.rows)),
    }


def _write_numbers(shards: Sequence[Shard], plan: Plan, buffer: Path) -> None:
    """Write all of the buffer but for the chunks of pictures."""
    ends = np.cumsum([shard.made.rows for shard in shards])
    root = zarr.create_group(store=buffer, zarr_format=FORMAT, attributes=_about(shards, plan))
    root.create_array(ENDS, data=ends.astype(np.int64), chunks=ends.shape)
    data = root.create_group(DATA)
    numbers = create_numbers(data, plan, int(ends[-1]))
    for _ in create_pictures(data, plan, int(ends[-1]), _optics(shards)):
        pass  # what they hold is copied
    for shard, end in zip(shards, ends.tolist(), strict=True):
        with zarr.storage.ZipStore(shard.folder / SHARD, mode="r") as store:
            made = zarr.open_group(store=store, path=DATA, mode="r")
            for name in (STATE, ACTION, TIME):
                values = made[name][:]
                if len(values) != shard.made.rows:
                    raise EpisodeError(f"{shard.source.episode_id}: its shard has not {shard.made.rows} rows")
                numbers[name][end - len(values) : end] = values


def _optics(shards: Sequence[Shard]) -> dict[str, Any]:
    """Return the optics of the cameras that were the same in all episodes; `station.json` has those of each."""
    first, *others = (shard.made.facts["optics"] for shard in shards)
    return {name: known for name, known in first.items() if all(other.get(name) == known for other in others)}


def _copy_pictures(shards: Sequence[Shard], plan: Plan, put: Put) -> None:
    """Give the chunk of each picture its number in the whole."""
    names = {f"{DATA}/{picture_name(camera)}" for camera in plan.rows.common.pictures}
    begin = 0
    for shard in shards:
        with zipfile.ZipFile(shard.folder / SHARD) as archive:
            for path, row, rest in _chunks(archive, names):
                put(f"{path}/{begin + row}.{rest}", archive.read(f"{path}/{row}.{rest}"))
        begin += shard.made.rows


def _chunks(archive: zipfile.ZipFile, arrays: set[str]) -> Iterator[tuple[str, int, str]]:
    """Yield array, number along the first axis, and the other numbers of each chunk; one that is all zeros is none."""
    for name in archive.namelist():
        array, _, chunk = name.rpartition("/")
        row, _, rest = chunk.partition(".")
        if array in arrays and row.isdigit():
            yield array, int(row), rest


def _write(file: Path, data: bytes) -> None:
    file.write_bytes(data)


def _add(archive: zipfile.ZipFile, name: str, data: bytes) -> None:
    archive.writestr(zipfile.ZipInfo(name, _WHEN), data)


def _about(shards: Sequence[Shard], plan: Plan) -> dict[str, Any]:
    """Return the attributes of the buffer: what `station.json` says at length."""
    rows = plan.rows
    return {
        "fps": rows.fps,
        "robot": rows.common.robot,
        "episode_ids": [shard.source.episode_id for shard in shards],
        "tasks": [shard.made.facts["task"] for shard in shards],
        "success": [shard.made.facts["success"] for shard in shards],
        "verdicts": [shard.made.facts["verdict"] for shard in shards],
        "trim": rows.trim,
        "software": msgspec.to_builtins(software()),
    }


def _how(plan: Plan) -> list[str]:
    common = plan.rows.common
    names = [STATE, ACTION, *(picture_name(camera) for camera in common.pictures)]
    observed = {
        STATE: {"shape": [sum(len(one.names) for one in common.state)], "type": "low_dim"},
        **{
            picture_name(camera): {"shape": [3, camera.height, camera.width], "type": "rgb"}
            for camera in common.cameras
        },
    }
    shapes = {"obs": observed, "action": {"shape": [sum(len(one.names) for one in common.action)]}}
    suffix = ".zip" if plan.store == "zip" else ""
    return [
        "Episode i is the rows `episode_ends[i - 1]` to `episode_ends[i] - 1`. Names and units of the numbers are "
        "attributes of each array (`names`, `units`), episodes and rate those of the root. diffusion_policy sets "
        "episodes aside by itself (`val_ratio`).",
        "",
        "```python",
        f'ReplayBuffer.copy_from_path("{BUFFER}{suffix}", keys={json.dumps(names)})',
        "```",
        "",
        f"Shapes for its task (`shape_meta`){_NO_DEPTH if common.depths else ''}:",
        "",
        "```json",
        json.dumps(shapes, indent=2),
        "```",
    ]
