"""A G1 that walks or tracks: each a policy around another, which listens to one part of a command of both.

`g1-walks` is around a policy that follows velocities, `g1-tracks` around one that follows TWIST2's commands. Both take
`adapters.commands.g1_walk_track`, so one hands over to the other while the robot moves; each part of the command has a
key, a gate and a freshness of its own, whoever drives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from adapters.commands import twist2, velocity
from adapters.commands.g1_parts import ARMS
from adapters.commands.g1_walk_track import FORMAT, TRACK, WALK
from adapters.policies.g1_whole import OnAllJoints
from adapters.policies.tracker.policy import TrackerPolicy
from adapters.policies.walk.policy import G1WalkPolicy
from adapters.robots.g1.joints import G1_29, LEGS, WAIST
from station import registry
from station.errors import ConfigError
from station.protocols import Floats, Floats32, JointTargets, Policy, RobotState, TakesOver

FARTHEST_RAD = 1.6
"""How far a joint may be from where a motion asks it to be as a policy that tracks takes over [rad]: as far as was
tried, at 12 moments of a squat and a reach, from a stand and from 0.5 m/s. None of these fell."""

FARTHEST_LEG_RAD = 1.2
"""How far a joint of legs or waist may be from where a policy that walks stands, as that takes over [rad]. Of 72 such
hand-overs one fell: out of a deep squat, a knee 1.3 rad away, whose feet were apart from the stride before."""

_LOWER = slice(0, len(LEGS) + len(WAIST))

_STANDS = twist2.FORMAT.default[-len(G1_29) :]
"""Where joints are held that a policy does not drive [rad]."""

_BEHIND_VELOCITIES = {name: each.default[3:] for name, each in velocity.FORMATS.items()} | {
    f"g1-arms-{name}": np.concatenate([each.default[3:], _STANDS[-len(ARMS) :]])
    for name, each in velocity.FORMATS.items()
}


class _OfPart(OnAllJoints):
    """A policy inside that gets its part of the command."""

    NAME: ClassVar[str]
    REST: ClassVar[Mapping[str, Floats]]
    """What the one inside may follow, by registered name, and what is asked of it behind its part of the command."""
    PART: ClassVar[slice]
    PART_NAME: ClassVar[str]

    def __init__(self, inside: str, checkpoint: Path, options: dict[str, Any] | None) -> None:
        made: Policy = registry.find("policy", inside)(checkpoint, **(options or {}))
        follows = made.spec.command
        if follows not in self.REST:
            expected = " or ".join(map(repr, self.REST))
            raise ConfigError(f"{self.NAME}: policy {inside!r} follows {follows!r} commands; expected {expected}")
        self._rest = self.REST[follows]
        super().__init__(made, _STANDS, f"{self.NAME}: policy {inside!r}")
        self._why_not = made.why_not_take_over if isinstance(made, TakesOver) else None
        self._spec = replace(self._spec, name=self.NAME, command=FORMAT.name, part=self.PART_NAME)

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation of the policy inside, of its part of the command."""
        return super().observe(state, self._own(command))

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return the targets of the policy inside, for its part of the command."""
        return super().targets(action, self._own(command))

    def why_not_take_over(self, state: RobotState, command: Floats) -> str:
        """Return why the policy inside cannot drive from here on, or ""."""
        return self._why_not(state, self._own(command)) if self._why_not is not None else ""

    def _own(self, command: Floats) -> Floats:
        return np.concatenate([command[self.PART], self._rest])


class WalksPolicy(_OfPart):
    """A policy that follows velocities; where it takes a height, a torso or arms as well, these are as in a stand.

    Args:
        checkpoint: Of the policy inside.
        walk: Its registered name.
        walk_options: Its further arguments.

    Raises:
        UnknownName: it is not registered.
        ConfigError: it follows other commands, or drives joints that a G1 does not have.
        BadFile: as the policy inside says.
    """

    NAME, REST = "g1-walks", _BEHIND_VELOCITIES
    PART, PART_NAME = WALK, "walk"
    CHECKPOINT = G1WalkPolicy.CHECKPOINT

    def __init__(self, checkpoint: Path, *, walk: str = "g1-walk", walk_options: dict[str, Any] | None = None) -> None:
        super().__init__(walk, checkpoint, walk_options)
        given, ends = self._spec, (FORMAT.lower.copy(), FORMAT.upper.copy())
        for whole, own in zip(ends, (given.command_lower, given.command_upper), strict=True):
            if own is not None:
                whole[WALK] = own[WALK]
        self._spec = replace(given, command_lower=ends[0], command_upper=ends[1])

    def why_not_take_over(self, state: RobotState, command: Floats) -> str:
        """Return why not: legs or waist are far from a stand, or as the policy inside says."""
        joint, gap_rad = _farthest(state.q[_LOWER] - self._spec.default_q[_LOWER])
        if gap_rad > FARTHEST_LEG_RAD:
            return (
                f"{joint} is {gap_rad:.1f} rad from where it is when the robot stands, and a policy that walks takes "
                f"over within {FARTHEST_LEG_RAD:g} rad; have the robot stand first"
            )
        return super().why_not_take_over(state, command)


class TracksPolicy(_OfPart):
    """A policy that follows motions.

    Args:
        checkpoint: Of the policy inside.
        track: Its registered name.
        track_options: Its further arguments.

    Raises:
        UnknownName: it is not registered.
        ConfigError: it follows other commands than TWIST2's, or drives joints that a G1 does not have.
        BadFile: as the policy inside says.
    """

    NAME, REST = "g1-tracks", {twist2.FORMAT.name: np.zeros(0)}
    PART, PART_NAME = TRACK, "track"
    CHECKPOINT = TrackerPolicy.CHECKPOINT

    def __init__(
        self, checkpoint: Path, *, track: str = "tracker", track_options: dict[str, Any] | None = None
    ) -> None:
        super().__init__(track, checkpoint, track_options)

    def why_not_take_over(self, state: RobotState, command: Floats) -> str:
        """Return why not: a joint is far from where the motion asks it to be, or as the policy inside says."""
        joint, gap_rad = _farthest(command[self.PART][-len(G1_29) :] - state.q)
        if gap_rad > FARTHEST_RAD:
            return (
                f"the motion asks {joint} to be {gap_rad:.1f} rad from where it is, and a policy that tracks takes "
                f"over within {FARTHEST_RAD:g} rad; ask again where the motion stands, or before it begins"
            )
        return super().why_not_take_over(state, command)


def _farthest(differences: Floats) -> tuple[str, float]:
    """Return which of the G1's first joints differs most, and by how much [rad]."""
    worst = int(np.abs(differences).argmax())
    return G1_29[worst], float(abs(differences[worst]))
