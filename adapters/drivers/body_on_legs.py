"""What drivers share that move arms one way and legs by sticks: a walking body, and arms put on it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from adapters.commands.twist2 import FORMAT
from adapters.drivers.command_shaper import CommandShaper
from adapters.drivers.fingers import Fingers
from adapters.drivers.sticks import Sticks
from adapters.retarget.arm_ik import ARMS
from adapters.retarget.walking import VelocityCommand, Walker
from adapters.robots.g1.joints import G1_29
from station.protocols import Floats

HEAD = len(FORMAT.default) - len(G1_29)
"""Elements of a command before its joints."""


class BodyOnLegs:
    """A body that stands or walks, and commands made of it.

    Until `begin` the command that was taken up stands, whatever it is.
    """

    def __init__(self) -> None:
        self.shaper = CommandShaper(FORMAT)
        self.sticks, self.fingers = Sticks(), Fingers()
        self._walker = Walker()
        self._has_begun = False

    @property
    def auxiliary(self) -> Mapping[str, Floats]:
        """Values of the keys beside the command."""
        return {**FORMAT.auxiliary, **self.fingers.commands}

    @property
    def is_standing(self) -> bool:
        """Whether the legs have come to a stand."""
        return self._walker.is_standing

    def joints(self, names: tuple[str, ...] = ARMS) -> Floats:
        """Return joints of the command that stands [rad]."""
        return self.shaper.sent[[HEAD + G1_29.index(name) for name in names]]

    def resume_from(self, command: Floats) -> None:
        """Continue from another writer's command; the legs stand from now on."""
        self.shaper.resume_from(command)
        self.sticks, self._walker, self._has_begun = Sticks(), Walker(), False

    def begin(self) -> Floats:
        """Go from the command that stands to what is asked from now on; return the former."""
        self._has_begun = True
        return self.shaper.sent.copy()

    def send(self, wish: VelocityCommand, dt_s: float, arms: Mapping[str, float] | None = None) -> Floats:
        """Go on for a period [s].

        Args:
            wish: For the legs.
            dt_s: The period.
            arms: Joints of arms and waist by name [rad]; None lets the arms swing.

        Returns:
            The command.
        """
        if not self._has_begun:
            return self.shaper.sent.copy()
        reference = self._walker.step(dt_s, wish, arms)
        return self.shaper.send(FORMAT.encode(reference, G1_29), dt_s)


def named(names: tuple[str, ...], values: Floats) -> dict[str, float]:
    """Return values by name."""
    return dict(zip(names, np.asarray(values).tolist(), strict=True))
