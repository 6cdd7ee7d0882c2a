"""Where the commands of a case come from: each source gives one vector per tick, or None when nothing comes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from station.contract import names_of
from station.control.tracking import VELOCITIES
from station.errors import ConfigError
from station.motion.playback import Playback
from station.protocols import CommandFormat, Floats, Motion
from station.suite.cases import Silence, Velocity

Commands = Callable[[float], Floats | None]
"""From the time since the start [s], which only grows, to a command vector, shape (m,)."""

Span = tuple[float, float]
"""Begin and end, since the start [s]."""

REACHING = ("shoulder", "elbow")
WRIST = ("wrist",)
_ARM_WORDS = REACHING + WRIST
_SHORTEST_S, _LONGEST_S = 0.3, 3.0  # from one pose of an arm to the next
_SPEED_PART = 0.8  # of what the joints can do
_MIN_JERK_PEAK = 1.875  # greatest speed of a minimum-jerk move, over its mean


def silence(_: float) -> Floats | None:
    """Give nothing, ever."""
    return None


def playing_on(motion: Motion, command_format: CommandFormat, *, period_s: float) -> Commands:
    """Play a motion again and again, as the motion server does with `loop`."""
    playback = Playback(motion, command_format, lead_s=period_s, loop=True)
    return lambda now_s: playback.step(period_s if now_s else 0.0).command


def velocity(
    command_format: CommandFormat, wanted: Velocity, *, from_s: float, until_s: float, quiet: Span | None = None
) -> Commands:
    """Ask for a velocity for a while, and before and after it for none.

    Args:
        command_format: Its contract names the velocities.
        wanted: The velocity.
        from_s, until_s: When it begins and ends [s].
        quiet: From when to when nothing comes [s].
    """
    names = names_of(command_format.elements)
    still = np.array(command_format.default)
    moving = still.copy()
    moving[[names.index(name) for name in VELOCITIES]] = wanted

    def command(now_s: float) -> Floats | None:
        if quiet is not None and quiet[0] <= now_s < quiet[1]:
            return None
        return moving if from_s <= now_s < until_s else still

    return command


def cut(
    motion: Motion, command_format: CommandFormat, quiet: Silence, *, enter_s: float, at_s: float, lead_s: float
) -> Commands:
    """Enter a motion at once at `at_s - enter_s`, fall silent at `at_s` of it, and come back; nothing after its end.

    No blend but the gate's: so it is when a network drops, or when a command server starts in the middle of things.
    """

    def command(now_s: float) -> Floats | None:
        time_s = at_s - enter_s + now_s
        if now_s >= enter_s:
            if now_s < enter_s + quiet.seconds:
                return None
            time_s -= 0.0 if quiet.goes_on else quiet.seconds
        return (
            command_format.encode(motion.at(time_s + lead_s), motion.joint_names)
            if time_s <= motion.duration_s
            else None
        )

    return command


class RandomArms:
    """Stand, and take each arm from one random pose to the next, each pose anywhere within the joints' ranges.

    Moves have minimum jerk and last 0.3 to 3 s, short ones as often as long ones (log-uniform), longer where a joint
    would exceed 80 % of its greatest speed.

    Args:
        command_format: Its contract names the elements.
        joint_speeds: Greatest speed of joints by name [rad/s].
        seed: Of the poses and times.

    Raises:
        ConfigError: the format has no arms, or it is not known how fast they are.
    """

    def __init__(self, command_format: CommandFormat, joint_speeds: dict[str, float], seed: int) -> None:
        self._command_format = command_format
        self._random = np.random.default_rng(seed)
        arms = [arm for arm in _arms(command_format) if arm]
        if not arms:
            raise ConfigError(
                f"command format {command_format.name!r}: no element is named after a shoulder, elbow or wrist"
            )
        unknown = [name for arm in arms for name in arm if name not in joint_speeds]
        if unknown:
            raise ConfigError(f"the robot does not say how fast {unknown[0]} can be; the arms need it")
        self._arms = [
            _Arm(
                np.array(list(arm.values())),
                _SPEED_PART * np.array([joint_speeds[name] for name in arm]),
                command_format,
            )
            for arm in arms
        ]

    def __call__(self, now_s: float) -> Floats:
        """Return the vector of an instant."""
        command = np.array(self._command_format.default)
        for arm in self._arms:
            command[arm.elements] = arm.at(now_s, self._random)
        return command


class _Arm:
    """The moves of one arm: its elements of the command, their greatest speeds [rad/s], and where it is going."""

    def __init__(self, elements: Floats, speeds: Floats, command_format: CommandFormat) -> None:
        self.elements = elements
        self._speeds, self._lower, self._upper = speeds, command_format.lower[elements], command_format.upper[elements]
        self._begun_s, self._ends_s = 0.0, 0.0
        self._start = self._end = np.array(command_format.default[elements])

    def at(self, now_s: float, random: np.random.Generator) -> Floats:
        if now_s >= self._ends_s:
            self._begun_s, self._start = now_s, self._end
            self._end = random.uniform(self._lower, self._upper)
            least_s = float((_MIN_JERK_PEAK * np.abs(self._end - self._start) / self._speeds).max())
            wanted_s = float(np.exp(random.uniform(np.log(_SHORTEST_S), np.log(_LONGEST_S))))
            self._ends_s = now_s + max(least_s, wanted_s)
        part = (now_s - self._begun_s) / (self._ends_s - self._begun_s)
        smooth = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
        return np.asarray(self._start + smooth * (self._end - self._start))


def _arms(command_format: CommandFormat) -> list[dict[str, int]]:
    """Elements of the command that are joints of the left and of the right arm, by the name of the joint."""
    names = names_of(command_format.elements)
    joints = {name.removesuffix("_pos"): index for index, name in enumerate(names) if name.endswith("_pos")}
    return [
        {name: i for name, i in joints.items() if name.startswith(side) and any(word in name for word in _ARM_WORDS)}
        for side in ("left", "right")
    ]
