"""The envelope of the built-in tracker, of motions and of what its operators do: sticks, and hands at work.

`python -m research.tracker.envelope --out FILE` takes some minutes.
"""

from __future__ import annotations

import argparse
import sys
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from adapters.retarget.walking import FASTEST, FASTEST_BACK, HIGHEST_M, LOWEST_M, LOWEST_WALK_M, VelocityCommand, Walker
from adapters.robots.g1.joints import G1_29
from benchmarks.walking import session
from station import side_by_side
from station.control.rig import RigConfig, build
from station.protocols import Floats, Reference
from station.rehearse import rehearse
from station.suite import clips
from station.suite.survived import Survived, commands_of, is_survived, measured, play, write

CONFIG = RigConfig(robot="g1-mujoco", policy="tracker", envelope="none")
STANDS_S, HELD_S, TICK_S = 1.0, 15.0, 0.02
RESTLESS, RESTLESS_S = 20, 20.0
"""Streams of sticks that are pushed anywhere at random, and how long each is [s]."""

SEEDS, SESSION_S = range(100, 112), 120.0
"""Of sessions with hands at work as well, which are none of the benchmark's, and how long each is [s]."""

Wishes = list[tuple[float, VelocityCommand]]
"""What sticks ask for, and each for how long [s]."""


class Walk:
    """What the walker makes of sticks (`station.protocols.Motion`).

    Args:
        name: What it is called.
        wishes: What they ask for, from standing.
    """

    joint_names, fps = G1_29, 1.0 / TICK_S

    def __init__(self, name: str, wishes: Wishes) -> None:
        self.name, walker = name, Walker()
        asked = [(STANDS_S, VelocityCommand()), *wishes, (2.0 * STANDS_S, VelocityCommand())]
        self._references = [
            walker.step(TICK_S, wish) for seconds, wish in asked for _ in range(round(seconds / TICK_S))
        ]

    @property
    def duration_s(self) -> float:
        """From the first tick to the last [s]."""
        return TICK_S * (len(self._references) - 1)

    def at(self, time_s: float) -> Reference:
        """Return the reference of the tick nearest to a time [s]."""
        return self._references[min(max(round(time_s / TICK_S), 0), len(self._references) - 1)]

    def facts(self) -> dict[str, Any]:
        """Return nothing: it is no file."""
        return {}


def walks() -> dict[str, Wishes]:
    """Return all that sticks may ask for: held at ends and middles in all combinations, low, and restless."""
    ahead, aside, turning = FASTEST.tolist()
    speeds = (-FASTEST_BACK, 0.0, 0.5 * ahead, ahead)
    held = [VelocityCommand(*each) for each in product(speeds, (-aside, 0.0, aside), (-turning, 0.0, turning))]
    held += [VelocityCommand(height=height) for height in np.linspace(LOWEST_M, HIGHEST_M, 4)[:-1].tolist()]
    held += [
        VelocityCommand(x, y, yaw, LOWEST_WALK_M)
        for x, y, yaw in product((-FASTEST_BACK, ahead), (-aside, 0.0, aside), (-turning, 0.0, turning))
    ]
    named = {
        f"sticks {wish.velocity_x:g} {wish.velocity_y:g} {wish.yaw_rate:g} at {wish.height:.2f}": [(HELD_S, wish)]
        for wish in held
    }
    return named | {f"restless sticks {seed}": restless(seed) for seed in range(RESTLESS)}


def restless(seed: int) -> Wishes:
    """Return sticks that are pushed anywhere, beyond what the legs can as well; for every other seed not down."""
    random, wishes = np.random.default_rng(seed), Wishes()
    end = 2.0 * np.array([*FASTEST, 0.0]) + [0.0, 0.0, 0.0, HIGHEST_M]
    start = -2.0 * np.array([*FASTEST, 0.0]) + [0.0, 0.0, 0.0, LOWEST_M if seed % 2 else HIGHEST_M]
    while sum(seconds for seconds, _ in wishes) < RESTLESS_S:
        wishes.append((float(random.uniform(0.04, 3.0)), VelocityCommand(*random.uniform(start, end))))
    return wishes


def walked(named: tuple[str, Wishes]) -> Survived:
    """Have the robot walk by sticks."""
    rig, commands = build(CONFIG), list[Floats]()
    rehearsal = rehearse(
        Walk(*named), rig.policy, rig.robot, rig.command_format, period_s=rig.period_s,
        on_step=lambda _, record: commands.append(record.decision.vector),
    )  # fmt: skip
    return Survived(rehearsal, np.array(commands))


def worked(seed: int) -> tuple[bool, Floats]:
    """Have an operator walk by sticks, both hands at work; return whether the robot stood, and the commands."""
    commands: list[Floats] = []
    done = session(build(CONFIG), seed, SESSION_S, lambda record: commands.append(record.decision.vector))
    return not done.fell, np.array(commands)


def main() -> None:
    """Play all of it and write the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="the file: tracker.envelope.yaml")
    out = parser.parse_args().out
    of = commands_of(CONFIG)
    played = [*play(list(clips.find()[0].durations_s), CONFIG), *side_by_side.run(walked, list(walks().items()))]
    found = {each.rehearsal.motion: (is_survived(each), each.commands) for each in played}
    found |= {
        f"sticks and hands {seed}": done for seed, done in zip(SEEDS, side_by_side.run(worked, SEEDS), strict=True)
    }
    sys.stdout.writelines(f"left out: {name}\n" for name, (is_taken, _) in found.items() if not is_taken)
    taken = {name: commands for name, (is_taken, commands) in found.items() if is_taken}
    envelope = measured(list(taken.values()), of.command, of.period_s)
    write(envelope, out, list(taken), by="python -m research.tracker.envelope")


if __name__ == "__main__":
    main()
