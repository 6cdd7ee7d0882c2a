"""Tables for pandas, polars, duckdb and whatever else reads Parquet: a folder per key, in it a file per episode.

``KEY/EPISODE.parquet``: a row per write. Columns: ``episode``; ``log_time`` (arrival at the recorder) and
``publish_time`` (when it was written) as instants with nanoseconds, UTC; ``log_time_s`` and ``publish_time_s``, seconds
from the start of the episode; ``sequence``, the writer's number of the value; ``writer``; then one per element, called
as its contract calls it, of the type that the contract says. Units stand in the metadata of each field (``unit``) and,
as JSON, in that of the file (``station``).

``events.parquet``: what the station said and what the operator marked, of all episodes. ``episodes.parquet``: a row per
episode: task, operator, robot, policy, verdict, success. ``contents.json``: every table with its columns and units, and
what was left out.
"""

from __future__ import annotations

import hashlib
import json
import re
from array import array
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from adapters.exports import named_rows
from adapters.exports.named_rows import Plan, Row, Rows
from station.bus import keys
from station.contract import VectorCodec
from station.episode.reading.reader import EpisodeReader
from station.export.columns import KeyColumns
from station.export.kind import Shard, ShardResult, SkippedEpisode, Source

FIRST_COLUMNS = ("episode", "log_time", "log_time_s", "publish_time", "publish_time_s", "sequence", "writer")
EVENTS, EPISODES, CONTENTS = "events.parquet", "episodes.parquet", "contents.json"

_TABLES = "tables"  # folder of a shard
_COMPRESSION = "zstd"
_ROWS = 8192  # of a key in memory, and of a row group
_LONGEST_NAME = 150  # bytes; file systems take 255
_TYPES: dict[VectorCodec, str] = {"json-vector": "float64", "f64": "float64", "f32": "float32"}
_UTC = ("ns", "UTC")


def prepare(sources: Sequence[Source], options: named_rows.QuickLookOptions) -> Plan:
    """Return the plan.

    Raises:
        UsageError: as `named_rows.prepare`.
        StationError: pyarrow is not installed.
    """
    from adapters.exports import arrow_library  # noqa: F401 -- that it lacks is told before any work is done

    return named_rows.prepare(sources, options)


def convert(source: Source, plan: Plan, folder: Path) -> ShardResult:
    """Write the tables of one episode, a block of rows of each key in memory.

    Raises:
        EpisodeError: a key has no names for its numbers, or the episode has more keys than files can be open.
    """
    rows = Rows(source, plan.keys)
    rows.expect_files()
    described = {key: _described(rows, columns) for key, columns in rows.columns.items()}
    with ExitStack() as stack:
        tables = {
            key: stack.enter_context(
                _Table(folder / _TABLES / folder_name(key) / f"{source.episode_id}.parquet", rows, columns, about)
            )
            for (key, columns), about in zip(rows.columns.items(), described.values(), strict=True)
        }
        for row in rows:
            tables[row.key].add(row)
    events, unfit = _events(rows.reader)
    _write(folder / EVENTS, _EVENT_COLUMNS, events)
    made = rows.made()
    told = {"tables": described, "events_unfit": unfit, "episode": _about(rows.reader)}
    return msgspec.structs.replace(made, facts={**made.facts, **told})


def join(shards: Sequence[Shard], left_out: Sequence[SkippedEpisode], _plan: Plan, folder: Path) -> dict[str, Any]:
    """Put the tables of all episodes beside each other, and what there is to know of them.

    Raises:
        OSError: the disk refuses.
    """
    from station.export.shards import place

    for shard in shards:
        for file in sorted((shard.folder / _TABLES).rglob("*.parquet")):
            place(file, folder / file.relative_to(shard.folder / _TABLES))
    _concatenate([shard.folder / EVENTS for shard in shards], folder / EVENTS)
    about = [{**shard.made.facts["episode"], "verdict": shard.made.facts["verdict"]} for shard in shards]
    _write(folder / EPISODES, _EPISODE_COLUMNS, about)
    contents = json.dumps(_contents(shards, left_out), indent=2, ensure_ascii=False)
    (folder / CONTENTS).write_text(contents, encoding="utf-8")
    return {"tables": len({key for shard in shards for key in shard.made.facts["tables"]}), "notes": _notes(shards)}


def folder_name(key: str) -> str:
    """Return the folder of a key's table: no two keys have the same, and no reader takes it for anything else."""
    name = re.sub(r"[^A-Za-z0-9_-]", lambda found: "".join(f"%{byte:02X}" for byte in found[0].encode()), key)
    return name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}.{hashlib.sha256(key.encode()).hexdigest()}"


def column_names(columns: KeyColumns) -> list[str]:
    """Return what the elements of a key are called: as in its contract, with the key before a name that is taken."""
    found = list(FIRST_COLUMNS)
    for number, name in enumerate(columns.names):
        free = (name, f"{columns.key}.{name}", f"{columns.key}.{number}.{name}")
        found.append(next(each for each in free if each not in found))
    return found[len(FIRST_COLUMNS) :]


class _Table:
    """The file of one key; a context manager."""

    def __init__(self, file: Path, rows: Rows, columns: KeyColumns, about: Mapping[str, Any]) -> None:
        from adapters.exports.arrow_library import pa, pq

        self._pa, self._episode, self._start_ns = pa, rows.reader.episode_id, rows.start_ns
        self._type, self._width = np.dtype(_TYPES[columns.codec]), len(columns.names)
        self._empty()
        kind = pa.from_numpy_dtype(self._type)
        of_the_file = {"episode_id": self._episode, "start_ns": self._start_ns, **about}
        fields = [*_first_fields(pa), *(_field(pa, name, kind, unit) for name, unit in about["columns"].items())]
        self._schema = pa.schema(fields, metadata={"station": json.dumps(of_the_file, ensure_ascii=False)})
        file.parent.mkdir(parents=True)
        texts = ["episode", "writer"]  # only these repeat
        self._file = pq.ParquetWriter(file, self._schema, compression=_COMPRESSION, use_dictionary=texts)

    def add(self, row: Row) -> None:
        """Add a row; it is on its way to the disk when a block is full."""
        self._log_ns.append(row.log_ns)
        self._publish_ns.append(row.publish_ns)
        self._sequences.append(row.sequence)
        self._writers.append(row.writer)
        self._values.extend(row.values)
        if len(self._writers) == _ROWS:
            self._flush()

    def __enter__(self) -> _Table:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            if self._writers:
                self._flush()
        finally:
            self._file.close()

    def _empty(self) -> None:
        self._log_ns, self._publish_ns, self._sequences = array("q"), array("q"), array("q")
        self._values: array[float] = array(self._type.char)
        self._writers: list[str] = []

    def _flush(self) -> None:
        pa, count = self._pa, len(self._writers)
        times = [np.array(one, dtype=np.int64) for one in (self._log_ns, self._publish_ns)]
        texts = [pa.array([self._episode] * count, pa.string()), pa.array(self._writers, pa.string())]
        instants = [pa.array(one).cast(pa.timestamp(*_UTC)) for one in times]
        seconds = [pa.array((one - self._start_ns) / 1e9) for one in times]
        values = np.array(self._values, dtype=self._type).reshape(count, self._width)
        found = [
            texts[0], instants[0], seconds[0], instants[1], seconds[1],
            pa.array(np.array(self._sequences, dtype=np.int64)), texts[1],
            *(pa.array(np.ascontiguousarray(one)) for one in values.T),
        ]  # fmt: skip
        self._file.write_table(pa.table(found, schema=self._schema), row_group_size=_ROWS)
        self._empty()


def _first_fields(pa: Any) -> list[Any]:
    instant = pa.timestamp(*_UTC)
    kinds = (pa.string(), instant, pa.float64(), instant, pa.float64(), pa.int64(), pa.string())
    units = ("", "", "s", "", "s", "", "")
    return [_field(pa, *each) for each in zip(FIRST_COLUMNS, kinds, units, strict=True)]


def _field(pa: Any, name: str, kind: Any, unit: str) -> Any:
    return pa.field(name, kind, nullable=False, metadata={"unit": unit} if unit else None)


def _described(rows: Rows, columns: KeyColumns) -> dict[str, Any]:
    """Return what a table is: its key, what a row of it holds, and its columns with their units."""
    contract = rows.reader.contract(columns.key)
    return {
        "key": columns.key,
        "role": columns.role,
        "rate_hz": columns.rate_hz,
        "note": contract.note if contract is not None else "",
        "columns": dict(zip(column_names(columns), columns.units, strict=True)),
    }


_EVENT_COLUMNS = {
    "episode": "string", "log_time": "instant", "log_time_s": "float64", "kind": "string", "name": "string",
    "severity": "string", "source": "string", "detail": "string",
}  # fmt: skip
_EPISODE_COLUMNS = {
    "episode": "string", "start_time": "instant", "duration_s": "float64", "task": "string", "instruction": "string",
    "operator": "string", "interface": "string", "robot": "string", "policy": "string", "checkpoint_sha256": "string",
    "verdict": "string", "success": "bool", "falls": "int64", "discarded": "bool",
}  # fmt: skip


def _events(reader: EpisodeReader) -> tuple[list[dict[str, Any]], int]:
    """Return the station's events and the operator's marks in order of time, and how many events could not be read."""
    found: list[dict[str, Any]] = []
    unfit = 0
    for log_ns, event in reader.json(keys.EVENT):
        if not isinstance(event, dict):
            unfit += 1
            continue
        words = {name: str(event.get(name, "")) for name in ("name", "severity", "source")}
        detail = json.dumps(event.get("detail", {}), ensure_ascii=False)
        found.append({"log_time": log_ns, "kind": "event", **words, "detail": detail})
    for mark in reader.manifest.marks:
        at_ns = reader.start_ns + round(mark.at_s * 1e9)
        nothing = dict.fromkeys(("severity", "source", "detail"), "")
        found.append({"log_time": at_ns, "kind": "mark", "name": mark.label, **nothing})
    found.sort(key=lambda row: row["log_time"])
    of_all = [
        {**row, "episode": reader.episode_id, "log_time_s": (row["log_time"] - reader.start_ns) / 1e9} for row in found
    ]
    return of_all, unfit + reader.skipped.get(keys.EVENT, 0)


def _about(reader: EpisodeReader) -> dict[str, Any]:
    """Return the row of an episode."""
    manifest, flags = reader.manifest, reader.manifest.quality_flags
    return {
        "episode": reader.episode_id,
        "start_time": reader.start_ns,
        "duration_s": manifest.timing.duration_s,
        "task": manifest.task.name,
        "instruction": manifest.task.instruction,
        "operator": manifest.operator.id,
        "interface": manifest.operator.interface,
        "robot": manifest.robot.suffix,
        "policy": manifest.policy.name,
        "checkpoint_sha256": manifest.policy.sha256,
        "success": flags.success,
        "falls": flags.falls,
        "discarded": flags.discarded,
    }


def _write(file: Path, columns: Mapping[str, str], rows: Iterable[Mapping[str, Any]]) -> None:
    from adapters.exports.arrow_library import pa, pq

    kinds = {"string": pa.string(), "instant": pa.timestamp(*_UTC), "bool": pa.bool_()}
    schema = pa.schema([(name, kinds.get(kind) or getattr(pa, kind)()) for name, kind in columns.items()])
    pq.write_table(pa.Table.from_pylist(list(rows), schema=schema), file, compression=_COMPRESSION)


def _concatenate(files: Sequence[Path], target: Path) -> None:
    from adapters.exports.arrow_library import pq

    with pq.ParquetWriter(target, pq.read_schema(files[0]), compression=_COMPRESSION) as writer:
        for file in files:
            writer.write_table(pq.read_table(file))


def _contents(shards: Sequence[Shard], left_out: Sequence[SkippedEpisode]) -> dict[str, Any]:
    tables: dict[str, dict[str, Any]] = {}
    for shard in shards:
        for key, described in shard.made.facts["tables"].items():
            tables.setdefault(key, {"folder": folder_name(key), **described})
    return {
        "times": "log_time is arrival at the recorder, publish_time when it was written; *_s count from the start of "
        "the episode, which is start_time in episodes.parquet",
        "tables": tables,
        "episodes": [
            {
                "episode": shard.source.episode_id,
                **{name: shard.made.facts[name] for name in ("keys", "unfit", "left_out", "events_unfit")},
            }
            for shard in shards
        ],
        "left_out": [{"episode": each.source.episode_id, "reason": each.reason} for each in left_out],
    }


def _notes(shards: Sequence[Shard]) -> list[str]:
    """Return a line for each key whose columns or units are not the same in all episodes."""
    first: dict[str, tuple[str, Any]] = {}
    odd: dict[str, str] = {}
    for shard in shards:
        for key, described in shard.made.facts["tables"].items():
            episode, columns = first.setdefault(key, (shard.source.episode_id, described["columns"]))
            if columns != described["columns"] and key not in odd:
                odd[key] = f"{key}: {shard.source.episode_id} has other columns or units than {episode}"
    return [f"{line}; read their files apart, or export them apart" for line in odd.values()]
