"""The cases of the suite: each is one run of a robot from its start pose to the end of what is asked, or to a fall."""

from __future__ import annotations

import math
from typing import Literal

import msgspec

from station.suite.attacks import Attack

Group = Literal["stand", "track", "unseen", "follow", "push", "arms", "late", "gate", "hand-over", "envelope"]

Velocity = tuple[float, float, float]
"""Of the base in the frame of its heading: forward, to the left [m/s], turning left [rad/s]."""

STILL: Velocity = (0.0, 0.0, 0.0)


class Silence(msgspec.Struct, frozen=True):
    """A stream of commands that stops and comes back.

    Attributes:
        name: What the gate is doing when it comes back.
        seconds: How long nothing comes [s].
        goes_on: Whether the motion went on meanwhile (a network that dropped), or waited (a server that stopped).
    """

    name: Literal["standing", "holding", "returning"]
    seconds: float
    goes_on: bool


class Case(msgspec.Struct, frozen=True, kw_only=True):
    """What every case has.

    Attributes:
        group: Row of the table that it counts in.
        seconds: About how long it takes, simulated [s]; long cases are started first.
    """

    group: Group
    seconds: float

    @property
    def name(self) -> str:
        """What the table and the messages call it."""
        raise NotImplementedError


class Stand(Case, frozen=True, kw_only=True):
    """Stand without commands; `late_s` is how much later targets are applied [s]."""

    late_s: float = 0.0

    @property
    def name(self) -> str:
        """What it is called."""
        return f"stand {self.seconds:g} s{_late(self.late_s)}"


class Track(Case, frozen=True, kw_only=True):
    """Play a clip from standing to standing, as the motion server does; `late_s` as in `Stand`."""

    clip: str
    late_s: float = 0.0

    @property
    def name(self) -> str:
        """What it is called."""
        return f"{_short(self.clip)}{_late(self.late_s)}"


class Push(Case, frozen=True, kw_only=True):
    """Get a step in velocity while standing, or while a clip plays again and again.

    Attributes:
        speed_mps: Size of the step [m/s].
        towards_rad: Its direction in the world, from the robot's first heading; to the left is positive [rad].
        at_s: When [s].
        clip: What plays; "" for standing.
        velocity: What is commanded, of a policy that follows velocities.
    """

    speed_mps: float
    towards_rad: float
    at_s: float
    clip: str = ""
    velocity: Velocity = STILL

    @property
    def name(self) -> str:
        """What it is called."""
        doing = _short(self.clip) or _said(self.velocity)
        return f"{doing}, {self.speed_mps:g} m/s towards {math.degrees(self.towards_rad):.0f}° at {self.at_s:g} s"


class Arms(Case, frozen=True, kw_only=True):
    """Stand while the arms go to random poses within their full ranges."""

    seed: int

    @property
    def name(self) -> str:
        """What it is called."""
        return f"arms {self.seconds:g} s, seed {self.seed}"


class Cut(Case, frozen=True, kw_only=True):
    """Enter a clip somewhere, lose the commands at an instant of it [s], and get them back."""

    clip: str
    at_s: float
    silence: Silence

    @property
    def name(self) -> str:
        """What it is called."""
        lost = f"{self.at_s:.2f} s for {self.silence.seconds:g} s"
        return f"{_short(self.clip)}, lost at {lost}, back while {self.silence.name}"


class Walk(Case, frozen=True, kw_only=True):
    """Stand, follow a velocity, and stand again; `late_s` as in `Stand`."""

    velocity: Velocity
    late_s: float = 0.0

    @property
    def name(self) -> str:
        """What it is called."""
        return f"{_said(self.velocity)}{_late(self.late_s)}"


class Cease(Case, frozen=True, kw_only=True):
    """Follow a velocity, lose the commands, stand, and get them back."""

    velocity: Velocity

    @property
    def name(self) -> str:
        """What it is called."""
        return f"{_said(self.velocity)}, then silence"


class HandOver(Case, frozen=True, kw_only=True):
    """Follow a velocity while the policy and another take turns.

    Attributes:
        velocity: What is commanded.
        policy, checkpoint: The other one's family and file; the same policy once more where both are "".
    """

    velocity: Velocity
    policy: str = ""
    checkpoint: str = ""

    @property
    def name(self) -> str:
        """What it is called."""
        return f"{_said(self.velocity)}, taking turns with {self.policy or 'itself'}"


class Attacked(Case, frozen=True, kw_only=True):
    """Get wild commands, and then the last of them for a second.

    Attributes:
        attack: Of what kind.
        seed: Of all chance in it.
        clips: Whose frames are taken.
    """

    attack: Attack
    seed: int
    clips: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """What it is called."""
        return f"{self.attack}, seed {self.seed}"


def _said(velocity: Velocity) -> str:
    """What is commanded, in words; what is zero is left out."""
    parts = [f"{name} {value:+.3g}" for name, value in zip(("vx", "vy", "wz"), velocity, strict=True) if value]
    return " ".join(parts) or "standing"


def _short(clip: str) -> str:
    """The name of a file without its folders; that of a built-in clip as it is."""
    return clip.rpartition("/")[2]


def _late(late_s: float) -> str:
    return f", {late_s * 1e3:g} ms late" if late_s else ""
