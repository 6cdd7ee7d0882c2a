"""Wild commands, to find out what makes a robot fall: within the format, and beyond what a motion would ask for."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from station.control.envelope import Envelope, EnvelopeLimit
from station.motion.playback import Playback
from station.protocols import CommandFormat, Floats, Motion

Attack = Literal["jump", "swing", "drift", "edge", "frames", "mixed", "two"]
"""Jump between random commands; swing some elements by sine or square; drift to random commands; hold ends of ranges;
jump between frames of motions; a motion with elements replaced; the same by two writers in turn."""

ATTACKS: tuple[Attack, ...] = get_args(Attack)

_SHORTEST_S, _LONGEST_S = 0.1, 2.0  # that a random command is held, log-uniform
_SWINGS_S, _HELD_S, _TURN_S = 2.0, 4.0, 0.5
_SLOWEST_HZ, _FASTEST_HZ = 0.3, 6.0
_SHARES = (0.03, 0.1, 0.3, 1.0)  # of the elements that something is done to


def commands(
    attack: Attack, seed: int, command_format: CommandFormat, envelopes: Sequence[Envelope], motions: Sequence[Motion],
    *, seconds: float, period_s: float,
) -> tuple[Floats, list[str]]:  # fmt: skip
    """Return a stream of commands, shape (steps, m), and the writer of each.

    For half of the seeds each element may be anywhere within the format's range, for the others within the envelopes'.

    Args:
        attack: What kind.
        seed: Of all chance in it.
        command_format: Of the commands.
        envelopes: Of the policies that follow it.
        motions: Whose frames are taken; without, standing.
        seconds: How long it is [s].
        period_s: Time between two [s].
    """
    random = np.random.default_rng(seed)
    lower, upper = np.array(command_format.lower), np.array(command_format.upper)
    if random.random() < 0.5:
        limits = [EnvelopeLimit(envelope, command_format) for envelope in envelopes]
        lower = np.maximum.reduce([lower, *(each.lower for each in limits)])
        upper = np.minimum.reduce([upper, *(each.upper for each in limits)])
    steps, turn = round(seconds / period_s), round(_TURN_S / period_s)
    made = _MAKERS[attack](_Draw(random, command_format, lower, upper, motions, period_s), steps)
    return made, ["b" if attack == "two" and step // turn % 2 else "a" for step in range(steps)]


class _Draw:
    """What is drawn by chance, all of shape (m,) unless said."""

    def __init__(
        self, random: np.random.Generator, command_format: CommandFormat, lower: Floats, upper: Floats,
        motions: Sequence[Motion], period_s: float,
    ) -> None:  # fmt: skip
        self.random, self.lower, self.upper, self.period_s = random, lower, upper, period_s
        self.standing = np.array(command_format.default)
        self._format, self._motions = command_format, motions

    def steps(self) -> int:
        """For how many steps a command is held."""
        held_s = math.exp(self.random.uniform(math.log(_SHORTEST_S), math.log(_LONGEST_S)))
        return max(1, round(held_s / self.period_s))

    def anywhere(self) -> Floats:
        """Anywhere within the ranges; at times each element at an end."""
        return self.end() if self.random.random() < 0.3 else self.random.uniform(self.lower, self.upper)

    def end(self) -> Floats:
        """Each element at an end."""
        found: Floats = np.where(self.random.random(len(self.lower)) < 0.5, self.lower, self.upper)
        return found

    def some(self) -> NDArray[np.bool_]:
        """Whether something is done to each element."""
        share = float(self.random.choice(_SHARES))
        found: NDArray[np.bool_] = self.random.random(len(self.lower)) < share
        found[self.random.integers(len(found))] = True
        return found

    def played(self) -> Floats:
        """The commands of one motion, shape (steps, m); without motions, standing."""
        if not self._motions:
            return self.standing[None]
        motion = self._motions[int(self.random.integers(len(self._motions)))]
        playback = Playback(motion, self._format, lead_s=self.period_s)
        made = [playback.step(0.0).command]
        while not playback.is_done:
            made.append(playback.step(self.period_s).command)
        return np.array([command for command in made if command is not None])


def _jump(draw: _Draw, steps: int) -> Floats:
    return _pieces(steps, lambda: np.tile(draw.anywhere(), (draw.steps(), 1)))


def _edge(draw: _Draw, steps: int) -> Floats:
    held = round(_HELD_S / draw.period_s)
    return _pieces(steps, lambda: np.tile(np.where(draw.some(), draw.end(), draw.standing), (held, 1)))


def _swing(draw: _Draw, steps: int) -> Floats:
    random = draw.random

    def piece() -> Floats:
        at_s = draw.period_s * np.arange(round(_SWINGS_S / draw.period_s))
        turns = 2.0 * math.pi * math.exp(random.uniform(math.log(_SLOWEST_HZ), math.log(_FASTEST_HZ))) * at_s
        made = np.tile(draw.standing, (len(at_s), 1))
        for element in random.permutation(len(draw.lower))[: random.integers(1, 4)]:
            wave = np.sin(turns + random.uniform(0.0, 2.0 * math.pi))
            wave = np.sign(wave) if random.random() < 0.5 else wave
            end = np.where(wave > 0.0, draw.upper[element], draw.lower[element])
            made[:, element] += np.abs(wave) * (end - draw.standing[element])
        return made

    return _pieces(steps, piece)


def _drift(draw: _Draw, steps: int) -> Floats:
    at = draw.standing

    def piece() -> Floats:
        nonlocal at
        goal = np.where(draw.some(), draw.end(), at)
        part = np.linspace(0.0, 1.0, round(draw.random.uniform(1.0, _HELD_S) / draw.period_s))[:, None]
        made, at = at + part * (goal - at), goal
        return made

    return _pieces(steps, piece)


def _frames(draw: _Draw, steps: int) -> Floats:
    frames = draw.played()
    return _pieces(steps, lambda: np.tile(frames[draw.random.integers(len(frames))], (draw.steps(), 1)))


def _mixed(draw: _Draw, steps: int) -> Floats:
    base = draw.played()
    first = int(draw.random.integers(max(1, len(base) - steps)))
    made = base[np.minimum(first + np.arange(steps), len(base) - 1)]
    start = 0
    while start < steps:
        piece = slice(start, start := start + draw.steps())
        made[piece] = np.where(draw.some(), draw.anywhere(), made[piece])
    return made


def _pieces(steps: int, make: Callable[[], Floats]) -> Floats:
    made, count = [], 0
    while count < steps:
        made.append(make())
        count += len(made[-1])
    return np.concatenate(made)[:steps]


_MAKERS: dict[Attack, Callable[[_Draw, int], Floats]] = {
    "jump": _jump, "swing": _swing, "drift": _drift, "edge": _edge, "frames": _frames, "mixed": _mixed, "two": _mixed,
}  # fmt: skip
