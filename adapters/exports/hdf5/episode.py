"""One episode as a shard: ``episode.hdf5``; of robomimic's layout with all in its group ``demo``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from adapters.exports.hdf5.arrays import TIME, arrays, picture_path
from adapters.exports.hdf5.h5py_library import create, h5py
from adapters.exports.hdf5.plan import Plan
from adapters.exports.lerobot.episode import facts_of, joined, rows_of
from adapters.exports.lerobot.plan import ACTION, STATE, open_source
from station.episode.storage.manifest import Manifest
from station.export.kind import ShardResult, Source
from station.export.resample import Table

SHARD = "episode.hdf5"
DEMO = "demo"


def convert(source: Source, plan: Plan, folder: Path) -> ShardResult:
    """Write the shard of an episode.

    Raises:
        EpisodeError: it does not fit the plan, or cannot be read; names key or camera.
        OSError: the disk refuses.
    """
    reader = open_source(source)
    recorded, table, cut = rows_of(reader, plan.rows)
    facts = facts_of(reader, plan.rows, recorded, table, cut)
    with create(folder / SHARD) as file:
        group = file.create_group(DEMO) if plan.layout == "robomimic" else file
        _write_numbers(group, plan, table)
        if plan.layout == "robomimic":
            _write_outcome(group, reader.manifest, len(table.ticks_ns))
        group.attrs.update(_attributes(plan, reader.episode_id, facts["task"], len(table.ticks_ns)))
        if plan.rows.common.cameras:
            from adapters.exports.hdf5 import pictures

            facts["pictures"] = pictures.write(group, reader, plan, table)
            for camera in plan.rows.common.pictures:
                optics = facts["optics"].get(camera.name, {})
                group[picture_path(plan, camera)].attrs.update({name: json.dumps(one) for name, one in optics.items()})
    rows = len(table.ticks_ns)
    return ShardResult(seconds=rows / plan.rows.fps, rows=rows, facts=facts)


def _write_numbers(group: Any, plan: Plan, table: Table) -> None:
    common = plan.rows.common
    values = {STATE: joined(table.state, common.state), ACTION: joined(table.action, common.action)}
    for one in arrays(plan):
        numbers = values[ACTION if one.is_action else STATE][:, list(one.places)]
        array = group.create_dataset(one.path, data=numbers)
        for name, texts in (("names", one.names), ("units", one.units)):
            array.attrs[name] = np.array(texts, dtype=h5py.string_dtype())
    group.create_dataset(TIME, data=table.ticks_ns)


def _write_outcome(group: Any, manifest: Manifest, count: int) -> None:
    """Write what robomimic asks for: where the episode ends, and whether it was worth it."""
    is_last = np.arange(count) == count - 1
    is_done = manifest.quality_flags.success is True
    group.create_dataset("dones", data=is_last.astype(np.int64))
    group.create_dataset("rewards", data=(is_last & is_done).astype(np.float32))


def _attributes(plan: Plan, episode_id: str, task: str, count: int) -> dict[str, Any]:
    told = {"episode_id": episode_id, "task": task, "fps": plan.rows.fps}
    if plan.layout == "robomimic":
        return {"num_samples": count, **told}
    # Where `sim` is false, ACT's loader gives each observation the action before its own, since ALOHA's recorder wrote
    # the two apart. Here they belong together, whatever robot it was.
    return {"sim": True, "compress": plan.encoding == "jpeg", **told}
