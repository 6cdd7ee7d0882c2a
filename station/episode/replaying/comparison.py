"""Recorded vectors beside those that were computed again, and how far they are apart."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from station.protocols import Floats, Floats32


class Comparison(msgspec.Struct, kw_only=True):
    """Recorded against computed vectors.

    Attributes:
        compared: Vectors that were compared.
        different: Those with any bit that differs.
        max_abs_difference: Greatest difference of an element; infinite where a length or a NaN differs.
        first_different: Number of the first step that differs, from 0 in the file; None when none does.
        first_different_s: When that was, from the start of the episode [s]; once `place` has said it.
    """

    compared: int = 0
    different: int = 0
    max_abs_difference: float = 0.0
    first_different: int | None = None
    first_different_s: float | None = None

    def add(self, step: int, recorded: Floats32 | Floats, computed: Floats32 | Floats) -> bool:
        """Add a pair; return whether it is equal bit for bit."""
        self.compared += 1
        if recorded.tobytes() == computed.tobytes():
            return True
        self.different += 1
        if self.first_different is None:
            self.first_different = step
        if recorded.shape != computed.shape:
            self.max_abs_difference = np.inf
        else:
            gap = np.abs(recorded.astype(np.float64) - computed.astype(np.float64))
            gap = np.where(np.isnan(recorded) & np.isnan(computed), 0.0, gap)
            self.max_abs_difference = max(self.max_abs_difference, float(np.nan_to_num(gap, nan=np.inf).max()))
        return False

    def add_state(self, step: int, recorded: str, computed: str) -> bool:
        """Add a pair of states of a gate, by their names; return whether they are equal."""
        self.compared += 1
        if recorded != computed:
            self.different += 1
            self.first_different = step if self.first_different is None else self.first_different
        return recorded == computed

    @classmethod
    def of_all(cls, comparisons: Sequence[Comparison]) -> Comparison:
        """Return several as one; what differs first is the earliest of them."""
        first = [one.first_different for one in comparisons if one.first_different is not None]
        first_s = [one.first_different_s for one in comparisons if one.first_different_s is not None]
        return cls(
            compared=sum(one.compared for one in comparisons),
            different=sum(one.different for one in comparisons),
            max_abs_difference=max((one.max_abs_difference for one in comparisons), default=0.0),
            first_different=min(first, default=None),
            first_different_s=min(first_s, default=None),
        )

    def place(self, times_ns: Sequence[int], start_ns: int) -> None:
        """Say when the first difference was, by the time of every step [ns]."""
        if self.first_different is not None:
            self.first_different_s = round((times_ns[self.first_different] - start_ns) * 1e-9, 3)
