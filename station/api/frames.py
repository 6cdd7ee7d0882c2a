"""Recorded values as frames of pandas and polars, which are imported when one is asked for."""

from __future__ import annotations

import importlib
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from station.errors import StationError
from station.protocols import Floats

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl

TIME = "time_s"
"""Name of a frame's time: index of a pandas frame, first column of a polars frame [s from the episode's start]."""


def unique_names(names: Iterable[str]) -> list[str]:
    """Return names of columns, each once: one that comes again, or is called as the time is, becomes ``name.2``."""
    found = {TIME: None}
    for name in names:
        unique, number = name, 1
        while unique in found:
            number += 1
            unique = f"{name}.{number}"
        found[unique] = None
    return list(found)[1:]


def pandas_frame(time_s: Floats, columns: Mapping[str, Any], units: Mapping[str, str]) -> pd.DataFrame:
    """Return a pandas frame; its ``attrs["units"]`` holds the units by column, as pandas has no place for them.

    Raises:
        StationError: pandas is not installed.
    """
    library = _library("pandas")
    frame = library.DataFrame(dict(columns), index=library.Index(time_s, name=TIME))
    frame.attrs["units"] = dict(units)
    return frame


def polars_frame(time_s: Floats, columns: Mapping[str, Any]) -> pl.DataFrame:
    """Return a polars frame.

    Raises:
        StationError: polars is not installed.
    """
    return _library("polars").DataFrame({TIME: time_s, **columns})


def members(values: Sequence[Any]) -> dict[str, list[Any]]:
    """Return JSON values as columns: one per member of the objects, None where one lacks it; ``value`` for all else."""
    rows = [value if isinstance(value, dict) else {"value": value} for value in values]
    names = list(dict.fromkeys(name for row in rows for name in row))
    return {column: [row.get(name) for row in rows] for column, name in zip(unique_names(names), names, strict=True)}


def of_one_type(values: Sequence[Any]) -> list[Any]:
    """Return values as a column of one type: numbers, texts or truth values as they are, all else as JSON text."""
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int, float}:
        return [None if value is None else float(value) for value in values]
    if kinds in ({int}, {float}, {str}, {bool}):
        return list(values)
    return [None if value is None else json.dumps(value) for value in values]


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise StationError(f"a {name} frame needs {name} ({error}); pip install 'teleop-station[frames]'") from None
