"""Tables for a spreadsheet or a plot in one line: a CSV file per key.

``EPISODE/KEY.csv``: log_time_s and publish_time_s from the start of the episode, the writer's number of the value, then
one column per element, called as its contract calls it, with its unit in brackets. ``EPISODE/contents.json`` says what
is in them: notes of the contracts, rows, values that did not fit, keys that were left out.
"""

from __future__ import annotations

import csv
import re
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec

from adapters.exports.named_rows import Plan, Rows, in_seconds
from station.export.kind import ShardResult, Source

FIRST_COLUMNS = ("log_time_s", "publish_time_s", "sequence")
CONTENTS = "contents.json"

_LONGEST_NAME = 150  # characters; file systems take 255 bytes


def convert(source: Source, plan: Plan, folder: Path) -> ShardResult:
    """Write the tables of one episode, row by row.

    Raises:
        EpisodeError: a key has no names for its numbers, or the episode has more keys than files can be open.
    """
    rows = Rows(source, plan.keys)
    rows.expect_files()
    place = folder / source.episode_id
    place.mkdir()
    names = file_names(rows.columns)
    with ExitStack() as stack:
        tables: dict[str, Any] = {}
        for key, columns in rows.columns.items():
            file = stack.enter_context((place / names[key]).open("w", encoding="utf-8", newline=""))
            tables[key] = csv.writer(file, lineterminator="\n").writerow
            tables[key]([*FIRST_COLUMNS, *columns.titles])
        for key, log_ns, publish_ns, sequence, values, _ in rows:
            times = in_seconds(log_ns - rows.start_ns), in_seconds(publish_ns - rows.start_ns)
            tables[key]([*times, sequence, *values])
    (place / CONTENTS).write_bytes(msgspec.json.format(msgspec.json.encode(_contents(rows, names)), indent=2))
    return rows.made()


def file_names(keys: Any) -> dict[str, str]:
    """Return a file name for each key, all different, whatever the keys are."""
    found: dict[str, str] = {}
    for key in keys:
        stem = name = re.sub(r"[^A-Za-z0-9_.-]", "_", key)[:_LONGEST_NAME].lstrip(".") or "key"
        number = 1
        while f"{name}.csv" in found.values():
            number += 1
            name = f"{stem}.{number}"
        found[key] = f"{name}.csv"
    return found


def _contents(rows: Rows, names: dict[str, str]) -> dict[str, Any]:
    manifest = rows.reader.manifest
    contracts = {key: rows.reader.contract(key) for key in rows.columns}
    return {
        "episode_id": rows.reader.episode_id,
        "task": manifest.task.name,
        "instruction": manifest.task.instruction,
        "start_ns": rows.start_ns,
        "times": "seconds from start_ns (since the Unix epoch): log_time_s is arrival at the recorder, "
        "publish_time_s when it was written",
        "keys": {
            key: {
                "file": names[key],
                "rows": rows.counts[key],
                "unfit": rows.unfit[key],
                "role": columns.role,
                "note": contract.note if (contract := contracts[key]) is not None else "",
            }
            for key, columns in rows.columns.items()
        },
        "left_out": rows.left_out,
    }
