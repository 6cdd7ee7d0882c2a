"""pyarrow, or one line that says how to get it."""

from __future__ import annotations

import importlib
from typing import Any

from station.errors import StationError


def _load(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise StationError(f"Parquet files need pyarrow ({error}); install it with `pip install pyarrow`") from error


pa: Any = _load("pyarrow")  # has no types of its own
pq: Any = _load("pyarrow.parquet")
