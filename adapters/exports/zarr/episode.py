"""One episode as a shard: a buffer with its rows alone, in one zip file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from adapters.exports.lerobot.episode import facts_of, joined, rows_of
from adapters.exports.lerobot.plan import open_source
from adapters.exports.zarr.arrays import create_numbers, create_pictures
from adapters.exports.zarr.plan import ACTION, DATA, STATE, TIME, Plan
from adapters.exports.zarr.zarr_library import FORMAT, zarr
from station.episode.reading.reader import EpisodeReader
from station.export.kind import ShardResult, Source
from station.export.resample import Table

SHARD = "episode.zarr.zip"


def convert(source: Source, plan: Plan, folder: Path) -> ShardResult:
    """Write the shard of an episode.

    Raises:
        EpisodeError: it does not fit the plan, or cannot be read; names key or camera.
        OSError: the disk refuses.
    """
    reader, common = open_source(source), plan.rows.common
    recorded, table, cut = rows_of(reader, plan.rows)
    facts, count = facts_of(reader, plan.rows, recorded, table, cut), len(table.ticks_ns)
    with zarr.storage.ZipStore(folder / SHARD, mode="x") as store:
        data = zarr.create_group(store=store, path=DATA, zarr_format=FORMAT)
        numbers = create_numbers(data, plan, count)
        numbers[STATE][:] = joined(table.state, common.state)
        numbers[ACTION][:] = joined(table.action, common.action)
        numbers[TIME][:] = table.ticks_ns
        if common.pictures:
            facts["pictures"] = _write_pictures(data, reader, plan, table)
    return ShardResult(seconds=count / plan.rows.fps, rows=count, facts=facts)


def _write_pictures(data: Any, reader: EpisodeReader, plan: Plan, table: Table) -> dict[str, Any]:
    from adapters.exports.row_pictures import show_all
    from adapters.exports.row_pixels import RowPixels

    sinks = {
        camera: RowPixels(
            array, camera, f"{reader.episode_id}: camera {camera.name!r}", table.pictures[camera.key].numbers
        )
        for camera, array in create_pictures(data, plan, len(table.ticks_ns))
    }
    return show_all(reader, {camera: sink.rows for camera, sink in sinks.items()})
