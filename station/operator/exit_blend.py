"""The way out of driving: whatever moves comes to rest, then the robot is blended to its default pose; one that stays
where it is without a command is left there. Velocities that are left when the blend begins fade at once. Pure."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from station.blends import times_to_standing
from station.protocols import CommandFormat, Floats

COMES_TO_REST_S = 5.0
"""Longest wait for what was let go to come to rest [s]; a walk stands within two."""


class ExitBlend:
    """From whatever is driven to the default command.

    Args:
        form: Of the commands.
        blend_s: Time of the blend [s].
    """

    def __init__(self, form: CommandFormat, blend_s: float) -> None:
        self._form, self._default, self._blend_s = form, np.array(form.default), blend_s
        self._times_s = times_to_standing(form, blend_s)
        self._rested_s, self._blended_s = 0.0, 0.0
        self._start: Floats | None = None

    @property
    def is_done(self) -> bool:
        """Whether the default has been reached, or there is none to go to."""
        return self._start is not None and (self._form.stays or self._blended_s >= self._blend_s)

    def _part(self, time_s: Floats | float) -> Floats:
        """How much of a way to the default is done that takes so long [s], 0 to 1."""
        return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.minimum(self._blended_s / time_s, 1.0)))

    def companions(self, values: Mapping[str, Floats]) -> Mapping[str, Floats]:
        """Return the values beside the command: a neck goes along to its default, hands keep what they hold."""
        going = {key: self._form.companions[key] for key in self._form.stock.returning if key in values}
        part = self._part(self._blend_s)
        return {**values, **{key: values[key] + part * (np.asarray(rest) - values[key]) for key, rest in going.items()}}

    def step(self, command: Floats, dt_s: float, *, is_still: bool) -> Floats:
        """Return the command after a period.

        Args:
            command: What the driver wants, shape (m,); looked at until the blend begins.
            dt_s: The period [s].
            is_still: Whether the driver has come to rest.
        """
        if self._start is None:
            self._rested_s += dt_s
            if not is_still and self._rested_s < COMES_TO_REST_S:
                return command
            self._start = command
        if self._form.stays:
            return self._start
        self._blended_s += dt_s
        return self._start + self._part(self._times_s) * (self._default - self._start)
