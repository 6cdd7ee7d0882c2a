"""One episode as a shard: ``rows.parquet``, ``stats.json``, and one ``observation.images.NAME.mp4`` per camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from adapters.exports.lerobot import about, named, parquet, stats
from adapters.exports.lerobot.plan import (
    ACTION,
    AGE,
    COMMANDER,
    GATE,
    STATE,
    SUBTASK,
    TIME,
    Plan,
    expect_fit,
    missed,
    open_source,
)
from station.assets import sha256
from station.bus import keys
from station.episode.reading import frames
from station.episode.reading.messages import Ints
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.manifest import Manifest
from station.export import tracks, trim, words
from station.export.columns import KeyColumns
from station.export.kind import ShardResult, Source
from station.export.resample import Column, Table, ages_s, newest_word, resample
from station.protocols import Floats, Floats32

if TYPE_CHECKING:
    from adapters.exports.lerobot.pictures import Encoded

ROWS = "rows.parquet"
STATS = "stats.json"

TOLD_S = 0.05
"""Less of an episode is not worth a line [s]."""


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
    recorded, table, cut = rows_of(reader, plan)
    encoded = _encode(reader, plan, table, folder)
    spoken, commanders, subtasks = _spoken(reader, plan, recorded, table)
    columns: parquet.Columns = {
        STATE: joined(table.state, common.state),
        ACTION: joined(table.action, common.action),
        AGE + STATE: _ages(table.state, common.state),
        AGE + ACTION: _ages(table.action, common.action),
        **_picture_ages(plan, recorded.pictures, table, encoded),
        TIME: table.ticks_ns,
        **spoken,
    }
    parquet.write(folder / ROWS, parquet.table(columns))
    measured = EpisodeStats(
        columns={name: stats.of_rows(values) for name, values in columns.items() if name not in named.FACTS},
        pictures={camera.column: encoded[camera.key].pixels.plain() for camera in common.pictures},
    )
    (folder / STATS).write_bytes(msgspec.json.encode(measured))
    facts = {
        "pictures": {camera.name: _picture_facts(encoded[camera.key]) for camera in common.pictures},
        "commanders": commanders,
        "subtasks": subtasks,
        **facts_of(reader, plan, recorded, table, cut),
    }
    return ShardResult(seconds=len(table.ticks_ns) / plan.fps, rows=len(table.ticks_ns), facts=facts)


def facts_of(
    reader: EpisodeReader, plan: Plan, recorded: tracks.Recorded, table: Table, cut: trim.Trimmed
) -> dict[str, Any]:
    """Return what `dataset.notes` and `card.provenance` tell of the rows of an episode, but for its pictures."""
    return {
        "task": task_of(reader.manifest),
        "missed": missed(reader, plan),
        "trim": msgspec.to_builtins(cut),
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
    """Return where an episode comes from: hashes, operator, time, policy, optics of its cameras."""
    manifest, (known, _) = reader.manifest, frames.optics(reader)
    return {
        "sha256": {file.name: sha256(file) for file in sorted(reader.files)},
        **about.said(manifest),
        "checkpoint": Path(manifest.policy.checkpoint).name,
        "checkpoint_sha256": manifest.policy.sha256,
        "optics": {name: known[key].facts() for name, key in frames.all_pictures(reader).items() if key in known},
    }


def inspect(source: Source, plan: Plan) -> list[str]:
    """Do all that `convert` does but for video and files; return what the data set would lack of the episode.

    Raises:
        EpisodeError: as `convert`.
    """
    reader = open_source(source)
    _, _, cut = rows_of(reader, plan)
    lacks = [
        f"{source.episode_id}: {what}, not in the data set: {', '.join(names)}"
        for what, names in missed(reader, plan).items()
        if names
    ]
    return [*lacks, *([f"{source.episode_id}: {told}"] if (told := words_of(cut, plan.trim)) else [])]


def words_of(cut: trim.Trimmed, rule: trim.Trim) -> str:
    """Return in a line what was left out of an episode by --trim, "" for nothing."""
    if cut.why_not:
        return f"--trim {rule} left nothing out: {cut.why_not}"
    if cut.head_s + cut.tail_s < TOLD_S:
        return ""
    return f"--trim {rule} left out {cut.head_s:.1f} s at its beginning, {cut.tail_s:.1f} s at its end"


def rows_of(reader: EpisodeReader, plan: Plan) -> tuple[tracks.Recorded, Table, trim.Trimmed]:
    """Return what was read of an episode, its rows, and what was cut of them.

    Raises:
        EpisodeError: it does not fit the plan, or cannot be read; names key or camera.
        NotWanted: --trim leaves no row of it.
    """
    common = plan.common
    cameras = expect_fit(reader, plan)
    recorded = tracks.read(reader, common.read, cameras.values(), words.spellings(common.robot))
    table = resample(recorded, common.state, common.action, plan.fps, reader.episode_id, plan.pictures)
    gates = recorded.words.get(keys.command_gate(common.robot))
    return recorded, *trim.trimmed(reader, table, plan.trim, common.robot, gates)


def _spoken(
    reader: EpisodeReader, plan: Plan, recorded: tracks.Recorded, table: Table
) -> tuple[parquet.Columns, dict[str, int], dict[str, int]]:
    """Return the columns whose numbers stand for names, and how many rows each commander and each subtask has."""
    rows, robot = len(table.ticks_ns), plan.common.robot
    gate, source = keys.command_gate(robot), keys.command_source(robot)
    commander, commanders = named.counted(recorded.words.get(source), table.words.get(source), rows)
    columns = {
        GATE: named.gate_numbers(recorded.words.get(gate), table.words.get(gate), rows),
        COMMANDER: commander,
    }
    if plan.subtasks == "none":
        return columns, commanders, {}
    marks = trim.subtasks(reader)
    columns[SUBTASK], subtasks = named.counted(marks, newest_word(marks, table.ticks_ns), rows)
    return columns, commanders, subtasks


def _encode(reader: EpisodeReader, plan: Plan, table: Table, folder: Path) -> Mapping[str, Encoded]:
    if not plan.common.pictures:
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
        for camera in plan.common.pictures
    }


def _column(ages: Sequence[Floats]) -> Floats32:
    """Return ages as a column; a single one is a plain number, as LeRobot stores what has one element."""
    return (ages[0] if len(ages) == 1 else np.stack(ages, axis=1)).astype(np.float32)


def _picture_facts(encoded: Encoded) -> dict[str, Any]:
    return {"bad": encoded.bad, "distinct": len(np.unique(encoded.shown))}
