"""Reads a Rerun file back, entity by entity."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from numpy.typing import NDArray
from rerun.chunk import RrdReader


class Recorded:
    """What a file holds: rows of each entity, and the values of a component."""

    def __init__(self, path: Path) -> None:
        self._tables: dict[str, list[Any]] = {}
        for chunk in RrdReader(str(path)).stream():
            self._tables.setdefault(chunk.entity_path.lstrip("/"), []).append(chunk)

    @property
    def entities(self) -> set[str]:
        return set(self._tables)

    def rows(self, entity: str) -> int:
        """Rows that are not static."""
        return sum(chunk.num_rows for chunk in self._tables[entity] if not chunk.is_static)

    def column(self, entity: str, ending: str) -> list[Any]:
        """Values of the component whose name ends so, row by row; static ones included."""
        found: list[Any] = []
        for chunk in self._tables.get(entity, []):
            batch: pyarrow.RecordBatch = pyarrow.record_batch(chunk.to_record_batch())
            for name in batch.schema.names:
                if name.endswith(ending):
                    found += batch.column(name).to_pylist()
        return found

    def seconds(self, entity: str, timeline: str) -> NDArray[np.float64]:
        """Instants of an entity's rows on a duration timeline."""
        times: list[float] = []
        for chunk in self._tables[entity]:
            batch = pyarrow.record_batch(chunk.to_record_batch())
            if timeline in batch.schema.names:
                times += batch.column(timeline).cast(pyarrow.int64()).to_pylist()
        return np.array(times) * 1e-9


def verify(path: Path) -> None:
    """Fail unless Rerun itself finds the file sound."""
    subprocess.run([sys.executable, "-m", "rerun", "rrd", "verify", str(path)], check=True, timeout=60)
