"""Parquet as LeRobot reads it: vectors as lists of a fixed length, single numbers as plain columns."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.exports.arrow_library import pa, pq

Columns = dict[str, NDArray[Any]]
"""By name, shape (n,) or (n, m)."""

_COMPRESSION = "snappy"


def table(columns: Mapping[str, NDArray[Any]]) -> Any:
    """Return columns as an Arrow table."""
    return pa.table({name: _array(values) for name, values in columns.items()})


def read(file: Path) -> Columns:
    """Return the columns of a file that `write` wrote."""
    return _columns(pq.ParquetFile(file).read())


def read_parts(file: Path) -> Iterator[Columns]:
    """Yield the columns of a file that an `Appender` wrote, table by table."""
    found = pq.ParquetFile(file)
    for part in range(found.num_row_groups):
        yield _columns(found.read_row_group(part))


def write(file: Path, rows: Any) -> None:
    """Write a table."""
    file.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(rows, file, compression=_COMPRESSION)


class Appender:
    """Writes tables one behind the other into files of a limited size, each table as one row group.

    Args:
        folder: Where ``chunk-000/file-000.parquet`` … go, behind those that are there.
        limit_bytes: A file that has grown beyond this is the last but one.
        per_chunk: Files per folder.
    """

    def __init__(self, folder: Path, *, limit_bytes: int, per_chunk: int) -> None:
        self._folder, self._limit, self._per_chunk = folder, limit_bytes, per_chunk
        self._number = len(list(folder.glob("*/*.parquet"))) - 1
        self._writer: Any = None
        self._stream: Any = None

    def place(self) -> tuple[int, int]:
        """Return chunk and file that the next table goes to; begins a new file when the present one is full."""
        if self._stream is None or self._stream.tell() >= self._limit:
            self.close()
            self._number += 1
        return divmod(self._number, self._per_chunk)

    def add(self, rows: Any) -> None:
        """Write a table to where `place` said."""
        if self._writer is None:
            chunk, number = divmod(self._number, self._per_chunk)
            file = self._folder / f"chunk-{chunk:03d}" / f"file-{number:03d}.parquet"
            file.parent.mkdir(parents=True, exist_ok=True)
            self._stream = file.open("wb")
            self._writer = pq.ParquetWriter(self._stream, rows.schema, compression=_COMPRESSION)
        self._writer.write_table(rows, row_group_size=max(1, rows.num_rows))

    def close(self) -> None:
        """Finish the present file."""
        if self._writer is not None:
            self._writer.close()
            self._stream.close()
        self._writer = self._stream = None

    def abandon(self) -> None:
        """Let go of the present file without finishing it."""
        with contextlib.suppress(OSError, pa.ArrowException):  # what it was abandoned for is told by who abandons it
            self.close()


def write_texts(file: Path, what: str, texts: Sequence[str]) -> None:
    """Write tasks or subtasks as a pandas reader expects them: the number of each, with its text as the index."""
    index = f"{what}_index"
    rows = pa.table({index: pa.array(range(len(texts)), pa.int64()), what: pa.array(texts, pa.string())})
    columns = [
        {"name": index, "field_name": index, "pandas_type": "int64", "numpy_type": "int64"},
        {"name": what, "field_name": what, "pandas_type": "unicode", "numpy_type": "object"},
    ]
    about = {
        "index_columns": [what],
        "column_indexes": [],
        "columns": [{**column, "metadata": None} for column in columns],
        "pandas_version": "2.2.0",
    }
    write(file, rows.replace_schema_metadata({"pandas": json.dumps(about)}))


def _array(values: NDArray[Any]) -> Any:
    if values.ndim == 1:
        return pa.array(values)
    flat = pa.array(np.ascontiguousarray(values).reshape(-1))
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1])


def _columns(rows: Any) -> Columns:
    return {name: _values(rows.column(name).combine_chunks()) for name in rows.column_names}


def _values(array: Any) -> NDArray[Any]:
    if not pa.types.is_fixed_size_list(array.type):
        return np.asarray(array.to_numpy(zero_copy_only=False))
    return np.asarray(array.flatten().to_numpy(zero_copy_only=False)).reshape(len(array), array.type.list_size)
