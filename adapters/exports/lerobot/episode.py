"""One episode as a shard: ``rows.parquet``, ``stats.json``, and one ``observation.images.NAME.mp4`` per camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from adapters.exports.lerobot import parquet, stats
from adapters.exports.lerobot.plan import ACTION, AGE, STATE, TIME, Plan, expect_fit, missed, open_source
from station.assets import sha256
from station.episode.reading.messages import Ints
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.manifest import Manifest
from station.export import tracks
from station.export.columns import KeyColumns
from station.export.kind import ShardResult, Source
from station.export.resample import Column, Table, ages_s, resample
from station.protocols import Floats, Floats32

if TYPE_CHECKING:
    from adapters.exports.lerobot.pictures import Encoded

ROWS = "rows.parquet"
STATS = "stats.json"


class EpisodeStats(msgspec.Struct, frozen=True):
    """What stands in `STATS`: statistics by column, and by picture column what `stats.PixelCounts` takes."""

    columns: dict[str, stats.Stats]
    pictures: dict[str, dict[str, Any]]


def convert(source: Source, plan: Plan, folder: Path) -> ShardResult:
    """Write the shard of an episode.

    Raises:
        EpisodeError: it does not fit the plan, or cannot be read; names key or camera.
        OSError: the disk refuses.
    """
    common = plan.common
    reader = open_source(source)
    recorded, table = rows_of(reader, plan)
    encoded = _encode(reader, plan, table, folder)
    columns: parquet.Columns = {
        STATE: joined(table.state, common.state),
        ACTION: joined(table.action, common.action),
        AGE + STATE: _ages(table.state, common.state),
        AGE + ACTION: _ages(table.action, common.action),
        **_picture_ages(plan, recorded.pictures, table, encoded),
        TIME: table.ticks_ns,
    }
    parquet.write(folder / ROWS, parquet.table(columns))
    measured = EpisodeStats(
        columns={name: stats.of_rows(values) for name, values in columns.items()},
        pictures={camera.column: encoded[camera.key].pixels.plain() for camera in common.cameras},
    )
    (folder / STATS).write_bytes(msgspec.json.encode(measured))
    facts = {
        "pictures": {camera.name: _picture_facts(encoded[camera.key]) for camera in common.cameras},
        **facts_of(reader, plan, recorded, table),
    }
    return ShardResult(seconds=len(table.ticks_ns) / plan.fps, rows=len(table.ticks_ns), facts=facts)


def facts_of(reader: EpisodeReader, plan: Plan, recorded: tracks.Recorded, table: Table) -> dict[str, Any]:
    """Return what `dataset.notes` and `card.provenance` tell of the rows of an episode, but for its pictures."""
    return {
        "task": task_of(reader.manifest),
        "missed": missed(reader, plan),
        "head_s": table.head_s,
        "tail_s": table.tail_s,
        "without_own_step": table.without_own_step,
        "skipped": dict(tracks.skipped(recorded)),
        **provenance(reader),
    }


def task_of(manifest: Manifest) -> str:
    """Return the instruction of the task, or else its name."""
    return " ".join((manifest.task.instruction or manifest.task.name).split()) or "untitled"


def provenance(reader: EpisodeReader) -> dict[str, Any]:
    """Return where an episode comes from: hashes, operator, time, policy and verdict."""
    manifest = reader.manifest
    return {
        "sha256": {file.name: sha256(file) for file in sorted(reader.files)},
        "recorded": manifest.timing.started,
        "operator": manifest.operator.interface,
        "policy": manifest.policy.name,
        "checkpoint": Path(manifest.policy.checkpoint).name,
        "checkpoint_sha256": manifest.policy.sha256,
        "verdict": str(manifest.quality.get("verdict", "")),
    }


def inspect(source: Source, plan: Plan) -> list[str]:
    """Do all that `convert` does but for video and files; return what the data set would lack of the episode.

    Raises:
        EpisodeError: as `convert`.
    """
    reader = open_source(source)
    rows_of(reader, plan)
    return [
        f"{source.episode_id}: {what}, not in the data set: {', '.join(names)}"
        for what, names in missed(reader, plan).items()
        if names
    ]


def rows_of(reader: EpisodeReader, plan: Plan) -> tuple[tracks.Recorded, Table]:
    """Return what was read of an episode, and the rows of it.

    Raises:
        EpisodeError: it does not fit the plan, or cannot be read; names key or camera.
    """
    common = plan.common
    cameras = expect_fit(reader, plan)
    recorded = tracks.read(reader, common.read, cameras.values())
    return recorded, resample(recorded, common.state, common.action, plan.fps, reader.episode_id)


def _encode(reader: EpisodeReader, plan: Plan, table: Table, folder: Path) -> Mapping[str, Encoded]:
    if not plan.common.cameras:
        return {}
    from adapters.exports.lerobot import pictures

    return pictures.encode(reader, plan, {key: one.numbers for key, one in table.pictures.items()}, folder)


def joined(values: Mapping[str, Column], keys: Sequence[KeyColumns]) -> Floats32:
    """Return the numbers of some keys beside each other, shape (n, m)."""
    return np.concatenate([values[one.key].values for one in keys], axis=1).astype(np.float32)


def _ages(values: Mapping[str, Column], keys: Sequence[KeyColumns]) -> Floats32:
    return _column([values[one.key].ages_s for one in keys])


def _picture_ages(
    plan: Plan, taken: Mapping[str, Ints], table: Table, encoded: Mapping[str, Encoded]
) -> dict[str, Floats32]:
    """Return tick minus capture of the pictures that the videos really show [s]."""
    return {
        camera.age_column: _column([ages_s(table.ticks_ns, taken[camera.key][encoded[camera.key].shown])])
        for camera in plan.common.cameras
    }


def _column(ages: Sequence[Floats]) -> Floats32:
    """Return ages as a column; a single one is a plain number, as LeRobot stores what has one element."""
    return (ages[0] if len(ages) == 1 else np.stack(ages, axis=1)).astype(np.float32)


def _picture_facts(encoded: Encoded) -> dict[str, Any]:
    return {"bad": encoded.bad, "distinct": len(np.unique(encoded.shown))}
