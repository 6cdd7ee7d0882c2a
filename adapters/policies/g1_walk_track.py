"""A G1 that walks or tracks: each a policy around another, which listens to one part of a command of both.

`g1-walks` is around a policy that follows velocities, `g1-tracks` around one that follows TWIST2's commands. Both take
`adapters.commands.g1_walk_track`, so one hands over to the other while the robot moves; each part of the command has a
key, a gate and a freshness of its own, whoever drives.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from adapters.commands import g1_walk_track, twist2, velocity
from adapters.policies.g1_whole import OnAllJoints
from adapters.policies.holosoma import HolosomaPolicy
from adapters.policies.tracker.policy import TrackerPolicy
from adapters.robots.g1.joints import G1_29
from station import registry
from station.errors import ConfigError
from station.protocols import Floats, Floats32, JointTargets, Policy, PolicySpec, RobotState, TakesOver

FARTHEST_RAD = 1.6
"""How far a joint may be from where a motion asks it to be as its policy takes over [rad]: as far as was tried. At 12
moments of a squat and of a reach neither `tracker` nor `twist2` fell, from a stand and from 0.5 m/s. Poses to stand in
differ by 0.7."""


_STANDS = twist2.FORMAT.default[-len(G1_29) :]
"""Where joints are held that a policy does not drive [rad]."""


class _OfPart:
    """Implements `station.protocols.Policy` by another."""

    NAME: ClassVar[str]
    FOLLOWS: ClassVar[str]
    """Registered name of the commands that the one inside follows."""
    PART: ClassVar[slice]
    PART_NAME: ClassVar[str]

    def __init__(self, inside: str, checkpoint: Path, options: dict[str, Any] | None) -> None:
        made: Policy = registry.find("policy", inside)(checkpoint, **(options or {}))
        if made.spec.command != self.FOLLOWS:
            raise ConfigError(
                f"{self.NAME}: policy {inside!r} follows {made.spec.command!r} commands; expected {self.FOLLOWS!r}"
            )
        self._why_not = made.why_not_take_over if isinstance(made, TakesOver) else None
        self._inside = OnAllJoints(made, _STANDS, f"{self.NAME}: policy {inside!r}")
        self._spec = self._whole(self._inside.spec)

    @property
    def spec(self) -> PolicySpec:
        """The constants of the policy inside, for a command of both parts."""
        return self._spec

    def reset(self) -> None:
        """Forget what the policy inside remembers."""
        self._inside.reset()

    def observe(self, state: RobotState, command: Floats) -> Floats32:
        """Return the observation of the policy inside, of its part of the command."""
        return self._inside.observe(state, command[self.PART])

    def act(self, observation: Floats32) -> Floats32:
        """Return the raw output of the policy inside."""
        return self._inside.act(observation)

    def targets(self, action: Floats32, command: Floats) -> JointTargets:
        """Return the targets of the policy inside."""
        return self._inside.targets(action, command[self.PART])

    def restore(self, observation: Floats32) -> None:
        """Restore what the policy inside remembers."""
        self._inside.restore(observation)

    def why_not_take_over(self, state: RobotState, command: Floats) -> str:
        """Return why the policy inside cannot drive from here on, or ""."""
        return self._why_not(state, command[self.PART]) if self._why_not is not None else ""

    def _whole(self, spec: PolicySpec) -> PolicySpec:
        return replace(spec, name=self.NAME, command=g1_walk_track.FORMAT.name, part=self.PART_NAME)


class WalksPolicy(_OfPart):
    """A policy that follows velocities.

    Args:
        checkpoint: Of the policy inside.
        walk: Its registered name.
        walk_options: Its further arguments.

    Raises:
        UnknownName: it is not registered.
        ConfigError: it follows other commands, or drives joints that a G1 does not have.
        BadFile: as the policy inside says.
    """

    NAME, FOLLOWS = "g1-walks", velocity.FORMAT.name
    PART, PART_NAME = g1_walk_track.WALK, "walk"
    ORIGIN = f"the origin of the policy that its option `walk` names, for `holosoma` {HolosomaPolicy.ORIGIN}"

    def __init__(self, checkpoint: Path, *, walk: str = "holosoma", walk_options: dict[str, Any] | None = None) -> None:
        super().__init__(walk, checkpoint, walk_options)

    def _whole(self, spec: PolicySpec) -> PolicySpec:
        own = velocity.FORMAT.lower, velocity.FORMAT.upper
        lower, upper = (
            np.concatenate([end if given is None else given, motion])
            for given, end, motion in zip(
                (spec.command_lower, spec.command_upper), own, (twist2.FORMAT.lower, twist2.FORMAT.upper), strict=True
            )
        )
        return replace(super()._whole(spec), command_lower=lower, command_upper=upper)


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

    NAME, FOLLOWS = "g1-tracks", twist2.FORMAT.name
    PART, PART_NAME = g1_walk_track.TRACK, "track"
    CHECKPOINT = TrackerPolicy.CHECKPOINT

    def __init__(
        self, checkpoint: Path, *, track: str = "tracker", track_options: dict[str, Any] | None = None
    ) -> None:
        super().__init__(track, checkpoint, track_options)

    def why_not_take_over(self, state: RobotState, command: Floats) -> str:
        """Return why not: a joint is far from where the motion asks it to be, or as the policy inside says."""
        gaps = np.abs(command[self.PART][-len(G1_29) :] - state.q)
        worst = int(gaps.argmax())
        if gaps[worst] > FARTHEST_RAD:
            return (
                f"the motion asks {G1_29[worst]} to be {gaps[worst]:.1f} rad from where it is, and a policy takes over "
                f"within {FARTHEST_RAD:g} rad; ask again where it stands, or before it begins"
            )
        return super().why_not_take_over(state, command)
