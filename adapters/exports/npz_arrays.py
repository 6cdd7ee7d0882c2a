"""Arrays for numpy: one file per episode, readable without pickle.

For each key: ``KEY``, its values (k, m); ``KEY.names`` and ``KEY.units`` (m,); ``KEY.log_time_s`` and
``KEY.publish_time_s`` (k,) from the start of the episode, and ``KEY.sequence`` (k,). Besides ``episode_id``, ``task``
and ``start_ns``, the start of the episode since the Unix epoch.
"""

from __future__ import annotations

import zipfile
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.exports.named_rows import Plan, Rows
from station.export.columns import KeyColumns
from station.export.kind import ShardResult, Source


class _Held:
    """The numbers of one key, packed."""

    def __init__(self) -> None:
        self.log_ns, self.publish_ns, self.sequence = array("q"), array("q"), array("q")
        self.values = array("d")


def convert(source: Source, plan: Plan, folder: Path) -> ShardResult:
    """Write the arrays of one episode.

    Raises:
        EpisodeError: a key has no names for its numbers.
    """
    rows = Rows(source, plan.keys)
    held = {key: _Held() for key in rows.columns}
    for key, log_ns, publish_ns, sequence, values, _ in rows:
        one = held[key]
        one.log_ns.append(log_ns)
        one.publish_ns.append(publish_ns)
        one.sequence.append(sequence)
        one.values.extend(values)
    with zipfile.ZipFile(folder / f"{source.episode_id}.npz", "x", zipfile.ZIP_DEFLATED) as archive:
        for name, array_ in _about(rows):
            _put(archive, name, array_)
        for key, columns in rows.columns.items():
            for name, array_ in _arrays(columns, held.pop(key), rows.start_ns):
                _put(archive, name, array_)
    return rows.made()


def _about(rows: Rows) -> Iterator[tuple[str, NDArray[Any]]]:
    yield "episode_id", np.array(rows.reader.episode_id)
    yield "task", np.array(rows.reader.manifest.task.name)
    yield "start_ns", np.array(rows.start_ns, dtype=np.int64)


def _arrays(columns: KeyColumns, held: _Held, start_ns: int) -> Iterator[tuple[str, NDArray[Any]]]:
    key, width = columns.key, len(columns.names)
    yield key, np.array(held.values, dtype=np.float64).reshape(-1, width)
    yield f"{key}.names", np.array(columns.names)
    yield f"{key}.units", np.array(columns.units)
    yield f"{key}.log_time_s", (np.array(held.log_ns, dtype=np.int64) - start_ns) * 1e-9
    yield f"{key}.publish_time_s", (np.array(held.publish_ns, dtype=np.int64) - start_ns) * 1e-9
    yield f"{key}.sequence", np.array(held.sequence, dtype=np.int64)


def _put(archive: zipfile.ZipFile, name: str, values: NDArray[Any]) -> None:
    entry = zipfile.ZipInfo(f"{name}.npy")  # of no date, so that the same episode gives the same bytes
    entry.compress_type = zipfile.ZIP_DEFLATED
    with archive.open(entry, "w", force_zip64=True) as file:
        np.lib.format.write_array(file, values, allow_pickle=False)
