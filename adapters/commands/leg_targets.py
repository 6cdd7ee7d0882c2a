"""What a policy elsewhere asks of a G1's legs: positions of their joints, and how far the legs follow them.

| index | element, on ``action_targets_<robot>_legs`` |
|---|---|
| 0-11 | target of each joint of the legs [rad], in Unitree's order |
| 12 | share of the targets in what the legs do, 0 to 1; the rest is that the station's own policy stands |

Such targets pull a soft servo: they lie beyond where a joint can go, and leap from step to step. The share ends as
velocities do, at once, so that a commander that falls silent leaves a robot that stands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from adapters.robots.g1 import joints as g1
from adapters.robots.legged.command import PULL_RAD
from station.arms import JointCommand
from station.bus import keys
from station.contract import Element
from station.protocols import CommandFormat, Floats, Reference

SHARE = len(g1.LEGS)
"""Index of the share."""


@dataclass(frozen=True, slots=True, eq=False)
class _LegTargets(JointCommand):
    def encode(self, reference: Reference, joint_names: tuple[str, ...]) -> Floats:
        """Return the command that leaves the legs to the station, shape (13,): a motion has no targets of a network."""
        return self.default.copy()


class LegTargets:
    """For the legs of any G1 (`station.protocols.ForAnyRobot`); no policy narrows its range."""

    def for_robot(self, robot: str, lower: Floats | None = None, upper: Floats | None = None) -> CommandFormat:
        """Return the format of a robot's legs, by the suffix of their keys."""
        made = _LegTargets.within(
            "g1-leg-targets", robot, g1.LEGS, lower=g1.lower(g1.LEGS) - PULL_RAD, upper=g1.upper(g1.LEGS) + PULL_RAD,
            margin=np.zeros(SHARE), rate=np.full(SHARE, np.inf), stock_key=keys.action(f"targets_{robot}"),
        )  # fmt: skip
        default, lower, upper, margin, rate = (
            _with(array, share)
            for array, share in (
                (made.default, 0.0), (made.lower, 0.0), (made.upper, 1.0), (made.margin, 0.0), (made.rate, np.inf),
            )
        )  # fmt: skip
        return replace(
            made, default=default, lower=lower, upper=upper, margin=margin, rate=rate, holds_position=False,
            velocities=(SHARE,), elements=(*made.elements, Element("share", "")),
            note="targets of a policy elsewhere, which may lie beyond a joint's range; share: how far legs follow them",
        )  # fmt: skip


def _with(array: Floats, share: float) -> Floats:
    found = np.append(array, share)
    found.flags.writeable = False
    return found


LEG_TARGETS = LegTargets().for_robot("g1_29_legs")
"""Of the simulated G1."""
