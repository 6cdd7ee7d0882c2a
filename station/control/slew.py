"""How far a command may move in a tick: no faster than its rate, and into its range or within it. Pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from station.errors import ConfigError
from station.protocols import CommandFormat, Floats

LONGEST_TICK_S = 0.04
"""A tick stands for no more than this [s]: after a stall the robot would get the whole of it as one kick."""

_UNLIMITED = 1e12  # in place of infinity, of which nothing is no number


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """Where a command vector may be and how fast it may get there; each of shape (m,).

    Attributes:
        lower, upper: Range of each element.
        rate: Greatest change of each element per second.
    """

    lower: Floats
    upper: Floats
    rate: Floats

    @classmethod
    def of(cls, command_format: CommandFormat, factor: float = 1.0) -> Bounds:
        """Return the bounds of a format, its rates times a factor."""
        return cls(command_format.lower, command_format.upper, np.minimum(command_format.rate * factor, _UNLIMITED))

    def step(self, before: Floats, wanted: Floats, passed_s: float) -> Floats:
        """Return what comes nearest to a vector after some time; the very vector where range and rate allow it.

        The rate goes before the range: what is out of its range (an arm that was pushed there by hand) comes back at
        its rate, and is out of it until it is back. Without time nothing moves.

        Args:
            before: Where it was, shape (m,).
            wanted: Where to, shape (m,).
            passed_s: How much time has passed [s]; counts for `LONGEST_TICK_S` at most, and below 0 for none.
        """
        most = self.rate * min(max(passed_s, 0.0), LONGEST_TICK_S)
        moved: Floats = np.clip(np.clip(wanted, self.lower, self.upper), before - most, before + most)
        return moved

    def expect_back_within(self, default: Floats, blend_s: float) -> None:
        """See that no element is too slow to be back at its default after a blend.

        Raises:
            ConfigError: one is.
        """
        farthest = np.maximum(default - self.lower, self.upper - default)
        if (farthest > self.rate * blend_s).any():
            slowest = int(np.argmax(farthest - self.rate * blend_s))
            raise ConfigError(
                f"gate: element {slowest} needs more than blend_out_s ({blend_s:g} s) to return to standing: it may be "
                f"{farthest[slowest]:.3g} away and change by {self.rate[slowest]:.3g} a second; raise rate_factor or "
                "blend_out_s"
            )
