"""Values of an episode with their times: numbers as a table with named columns, JSON values as a list."""

from __future__ import annotations

import fnmatch
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from station.api.frames import members, of_one_type, pandas_frame, polars_frame
from station.errors import UnknownName
from station.printable import printable
from station.protocols import Floats

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl


@dataclass(frozen=True, eq=False, repr=False)
class Table:
    """Numbers with named columns: a row for each of n writes of a key, or for each of n policy steps.

    ``table["left_knee_pos"]`` is one column, shape (n,).

    Attributes:
        key: The key that holds the numbers.
        time_s: When each row arrived at the recorder, from the start of the episode, shape (n,) [s]; of policy steps,
            when the results of the step were written.
        written_s: When the writer wrote each row, from the start of the episode, shape (n,) [s]; equal to `time_s` for
            a writer without stamps.
        values: Shape (n, m), float64.
        names: Names of the m columns; numbers from "0" where the recording names none.
        units: Units of the m columns, "" for none.
        skipped: Recorded values that do not fit the key's contract: left out, or rows of NaN among policy steps.
    """

    key: str
    time_s: Floats
    written_s: Floats
    values: Floats
    names: tuple[str, ...]
    units: tuple[str, ...]
    skipped: int = 0

    def __len__(self) -> int:
        return len(self.time_s)

    def __getitem__(self, name: str) -> Floats:
        """Return a column, shape (n,).

        Raises:
            UnknownName: there is none of that name.
        """
        if name not in self.names:
            raise UnknownName(f"column of {self.key}", name, self.names)
        return self.values[:, self.names.index(name)]

    def select(self, *columns: str) -> Table:
        """Return the columns that fit any of some names or patterns, such as ``"*_pos"``, in the order of the table.

        Raises:
            UnknownName: a name or pattern fits no column.
        """
        for pattern in columns:
            if not fnmatch.filter(self.names, pattern):
                raise UnknownName(f"column of {self.key}", pattern, self.names)
        chosen = [
            index
            for index, name in enumerate(self.names)
            if any(fnmatch.fnmatchcase(name, pattern) for pattern in columns)
        ]
        return replace(
            self,
            values=self.values[:, chosen],
            names=tuple(self.names[index] for index in chosen),
            units=tuple(self.units[index] for index in chosen),
        )

    def pandas(self) -> pd.DataFrame:
        """Return a pandas frame: index ``time_s`` [s], a column per name; ``frame.attrs["units"]`` by column.

        Raises:
            StationError: pandas is not installed.
        """
        units = dict(zip(self.names, self.units, strict=True))
        return pandas_frame(self.time_s, self.columns(), units)

    def polars(self) -> pl.DataFrame:
        """Return a polars frame: column ``time_s`` [s], then a column per name; units are in `units`.

        Raises:
            StationError: polars is not installed.
        """
        return polars_frame(self.time_s, self.columns())

    def columns(self) -> dict[str, Floats]:
        """Return every column by its name, each of shape (n,)."""
        return {name: self.values[:, index] for index, name in enumerate(self.names)}

    def __repr__(self) -> str:
        titles = [f"{name} [{unit}]" if unit else name for name, unit in zip(self.names, self.units, strict=True)]
        left_out = f", {self.skipped} values do not fit" if self.skipped else ""
        text = f"{self.key}: {len(self)} rows of {len(self.names)} numbers{left_out}: {', '.join(titles)}"
        return printable(text, 1000)


class Record(NamedTuple):
    """One JSON value: when it arrived at the recorder, from the start of the episode [s], and what it decodes to."""

    time_s: float
    value: Any


class Records(list[Record]):
    """The JSON values of a key in order of arrival.

    Attributes:
        skipped: Recorded values that are no JSON, and are left out.
    """

    skipped: int = 0

    def pandas(self) -> pd.DataFrame:
        """Return a pandas frame: index ``time_s`` [s], a column per member of the objects, None where one lacks it.

        A member that is called ``time_s`` itself is the column ``time_s.2``; values that are no objects are in the
        column ``value``.

        Raises:
            StationError: pandas is not installed.
        """
        return pandas_frame(self._times(), members([record.value for record in self]), {})

    def polars(self) -> pl.DataFrame:
        """Return a polars frame: column ``time_s`` [s], then columns as in `pandas`.

        A column of lists, objects or values of several types holds JSON text.

        Raises:
            StationError: polars is not installed.
        """
        columns = members([record.value for record in self])
        return polars_frame(self._times(), {name: of_one_type(values) for name, values in columns.items()})

    def _times(self) -> Floats:
        return np.array([record.time_s for record in self], dtype=np.float64)
