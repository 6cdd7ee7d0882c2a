"""What the robots are asked to do: streams of TWIST2 commands at 50 Hz, shape (steps, 35), drawn at random.

A stream is what a command server would send; `research.tracker.gated` then does to it what the gate does.
"""

from __future__ import annotations

import numpy as np

from adapters.commands.twist2 import FORMAT
from adapters.motions import builtin
from adapters.motions.clip import Clip
from adapters.motions.load import load
from adapters.motions.transforms import mirrored, retimed
from adapters.robots.g1 import joints
from adapters.robots.g1.joints import G1_29
from research.tracker.recipe import Recipe
from station.errors import ConfigError
from station.protocols import Floats, Motion

DT_S = 0.02
HEAD = 6  # velocity x, y, height, roll, pitch, yaw rate; then the joints
ARMS = np.array([HEAD + i for i, name in enumerate(G1_29) if any(p in name for p in ("shoulder", "elbow", "wrist"))])
Stream = Floats


MOVES_ARMS = {"recorded": 0.2, "gait": 0.25, "builtin": 0.0, "posture": 0.5, "arms": 1.0, "stand": 0.0}
"""Of each kind of streams: how often its arms are moved about besides."""


def stream_of(motion: Motion) -> Stream:
    """Return the commands of a motion from its beginning to its end."""
    steps = int(motion.duration_s / DT_S) + 1
    return np.array([FORMAT.encode(motion.at(step * DT_S), motion.joint_names) for step in range(steps)])


class Streams:
    """Draws streams.

    Args:
        recipe: Which motions, at which speeds.
    """

    def __init__(self, recipe: Recipe) -> None:
        rng = np.random.default_rng(recipe.seed + 2)
        named = [name for name in builtin.names() if name not in builtin.HELD_BACK]
        pools = {
            "recorded": _recorded(recipe),
            "builtin": [stream_of(load(f"builtin:{name}")) for name in named],
            "gait": [_walk(rng) for _ in range(recipe.made)],
            "posture": [_postures(rng) for _ in range(recipe.made)],
        }
        self._pools: dict[str, list[Stream]] = pools | {"arms": [_standing()], "stand": [_standing()]}
        self._names, self._shares = list(recipe.shares), list(recipe.shares.values())
        if unknown := [name for name in self._names if name not in self._pools]:
            raise ConfigError(f"recipe: shares: unknown kind {unknown[0]!r}; known: {', '.join(self._pools)}")

    def draw(self, rng: np.random.Generator) -> tuple[str, Stream]:
        """Return a stream and its kind; in some the arms are moved about, whatever the legs do."""
        kind = str(rng.choice(self._names, p=self._shares))
        pool = self._pools[kind]
        stream = pool[int(rng.integers(len(pool)))]
        if rng.random() < MOVES_ARMS[kind]:
            stream = stream.copy()
            reach = float(rng.choice([0.5, 1.0]))
            stream[:, ARMS] = wandering(rng, len(stream), ARMS, start=stream[0, ARMS], reach=reach)
        return kind, stream


def wandering(
    rng: np.random.Generator, steps: int, elements: np.ndarray, *, start: Floats, reach: float = 1.0
) -> Floats:
    """Return elements that go from waypoint to waypoint, each at its own times, shape (steps, len(elements)).

    Args:
        rng: Draws waypoints and times.
        steps: Length.
        elements: Indices into the command.
        start: Their values at the beginning.
        reach: Share of their ranges that is used, about the standing value.
    """
    speed = rng.choice([0.4, 0.8, 1.5])  # slow, usual and hurried operators
    out = np.empty((steps, len(elements)))
    limit = joints.velocity(G1_29)
    for column, element in enumerate(elements):
        home = FORMAT.default[element]
        low, high = (home + reach * (end[element] - home) for end in (FORMAT.lower, FORMAT.upper))
        at, value = 0, float(start[column])
        while at < steps:
            goal = float(rng.uniform(low, high)) if rng.random() > 0.2 else value
            least_s = (
                abs(goal - value) * 1.9 / (0.8 * limit[element - HEAD])
            )  # peak of a minimum-jerk move: 1.875 x mean
            span = max(3, int(max(least_s, rng.uniform(0.3, 2.5) / speed) / DT_S))
            out[at : at + span, column] = (value + (goal - value) * min_jerk(span))[: steps - at]
            at, value = at + span, goal
    return out


def min_jerk(steps: int) -> Floats:
    """Return a rise from 0 to 1 that begins and ends at rest, shape (steps,)."""
    s = np.arange(1, steps + 1) / steps
    return np.asarray(s**3 * (10 - 15 * s + 6 * s * s))


def _recorded(recipe: Recipe) -> list[Stream]:
    found = []
    for number, reference in enumerate(recipe.motions, start=1):
        motion = load(reference)
        versions = [motion, mirrored(motion)] if number in recipe.mirrored else [motion]
        found += [stream_of(retimed(v, speed)) for v in versions for speed in sorted(set(recipe.speeds))]
    return found


def _walk(rng: np.random.Generator) -> Stream:
    """A walk with one to three velocities, between standing and standing."""
    while True:
        try:
            plans = [_plan(rng) for _ in range(int(rng.integers(1, 4)))]
            return stream_of(Clip(builtin.gait(*plans)))
        except ConfigError:  # a combination that the legs cannot do: draw another
            continue


def _plan(rng: np.random.Generator) -> builtin.WalkPlan:
    turns, strafes = rng.random() < 0.5, rng.random() < 0.5
    return builtin.WalkPlan(
        velocity_x=rng.uniform(-0.4, 0.8) if rng.random() < 0.7 else 0.0,
        velocity_y=rng.uniform(-0.3, 0.3) if strafes else 0.0,
        yaw_rate=rng.uniform(-0.8, 0.8) if turns else 0.0,
        duration_s=rng.uniform(2.0, 6.0),
        ramp_s=rng.uniform(0.3, 1.2),
        step_s=rng.uniform(0.38, 0.6),
        height=rng.uniform(0.7, 0.79),
        clearance=rng.uniform(0.04, 0.1),
        arm_swing=rng.uniform(0.0, 1.5),
    )


def _postures(rng: np.random.Generator) -> Stream:
    """Squats, bows, turns of the waist and shifts of the weight, several in a row."""
    while True:
        try:
            ways = [_posture(rng) for _ in range(int(rng.integers(1, 5)))]
            return stream_of(Clip(builtin.postures(*ways)))
        except ConfigError:
            continue


def _posture(rng: np.random.Generator) -> builtin.Posture:
    is_low = rng.random() < 0.5
    return builtin.Posture(
        move_s=rng.uniform(0.5, 2.5),
        hold_s=rng.uniform(0.0, 1.5),
        height=rng.uniform(0.45, 0.75) if is_low else rng.uniform(0.72, 0.79),
        pitch=rng.uniform(-0.15, 0.5),
        roll=rng.uniform(-0.15, 0.15),
        yaw=rng.uniform(-0.4, 0.4),
        shift_x=rng.uniform(-0.02, 0.03),
        shift_y=rng.uniform(-0.06, 0.06),
        joints={
            "waist_yaw": rng.uniform(-1.2, 1.2),
            "waist_roll": rng.uniform(-0.3, 0.3),
            "waist_pitch": rng.uniform(-0.2, 0.45),
        },
    )


def _standing() -> Stream:
    return np.tile(FORMAT.default, (round(12.0 / DT_S), 1))
