"""Measuring an operator with a device that sees the body: what the command line asks, and what a measurer answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from station.operator.sample import OperatorSample


@dataclass(frozen=True)
class MeasurementResult:
    """What came of it.

    Attributes:
        about: Who was measured, in a line.
        titles, rows: A table of it, for a person.
        note: What the table means.
        kept: What `OperatorMeasure.keep` writes to a file.
    """

    about: str
    titles: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str
    kept: Any


class OperatorMeasure(Protocol):
    """Measures an operator, of what a device shows of somebody who stands still. Knows no bus and no device."""

    @property
    def poses(self) -> Mapping[str, str]:
        """What the operator may be asked to do, by the name of the pose; the first one is the usual."""
        ...

    def why_not(self, sample: OperatorSample) -> str:
        """Return why such a sample cannot be measured, or ""."""
        ...

    def file(self, operator: str) -> Path:
        """Return where an operator's measurements are kept; perhaps not there.

        Raises:
            UsageError: that is no name of an operator.
        """
        ...

    def measure(
        self, readings: Sequence[OperatorSample], operator: str, pose: str, *, device: str, source: str
    ) -> MeasurementResult:
        """Measure an operator who stands still.

        Args:
            readings: Some seconds of samples.
            operator: Name.
            pose: One of `poses`.
            device, source: What they came from, for the file.

        Raises:
            StationError: too few samples, a body that moves or is lost, another pose, lengths that nobody has.
        """
        ...

    def keep(self, measured: MeasurementResult) -> Path:
        """Write what was measured; return the file.

        Raises:
            BadFile: it cannot be written.
        """
        ...

    def how_to_use(self, operator: str) -> str:
        """Return in a line how a station is told to go by it."""
        ...
