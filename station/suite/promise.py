"""What a policy promises: the limits, and the cases that they are held against. One screen, and nothing else counts."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from itertools import product

import msgspec

from station.control.gate import GateConfig
from station.suite.cases import Arms, Case, Cut, Group, Push, Silence, Stand, Track

LIMITS: dict[Group, str] = {
    "stand": "no fall, and no further drift or turn than the policy it is held against",
    "track": "no fall, mean |joint error| at most 0.10 rad",
    "unseen": "no fall, mean |joint error| at most 0.10 rad",
    "push": "no fall within 5 s",
    "arms": "no fall",
    "late": "no fall",
    "gate": "no fall",
}
"""The groups, in the order of the table, and what is asked in each."""

JOINT_ERROR_RAD = 0.10
"""Greatest mean joint error of each run of the groups `track` and `unseen`, as in `station.control.tracking`."""

SETTLED_S = 5.0
"""Drift is measured from here: from the start pose every policy first takes its own stance, some centimetres away."""

DRIFT_SLACK_M, TURN_SLACK_RAD = 0.001, 0.01
"""How much further a policy may drift and turn than the one that it is held against: both may stand like statues."""

UPSTREAM = tuple(f"twist2:motions/0807_yanjie_walk_00{number}.pkl" for number in range(1, 7))
"""Played where the user has them."""

HELD_BACK = (
    "builtin:walk-arc", "builtin:walk-fast", "builtin:walk-diagonal",
    f"{UPSTREAM[2]}#mirror", f"{UPSTREAM[5]}#mirror", f"{UPSTREAM[0]}#speed=1.2",
)  # fmt: skip
"""What no policy of ours was trained on; the group `unseen`."""

WAVING = "builtin:wave"
"""Played under pushes."""

_GATE = GateConfig()
SILENCES = (
    Silence("holding", 2.0 * _GATE.hold_after_s, goes_on=True),
    Silence("returning", 0.5 * _GATE.blend_out_s, goes_on=True),
    Silence("standing", _GATE.return_after_s + _GATE.blend_out_s + 1.0, goes_on=False),
)

PUSH_FROM_S, PUSH_SURVIVED_S = 3.0, 5.0  # the robot has settled by then; a fall after a push takes no longer
ENTER_S, AFTER_S = 2.0, 4.0  # each a second of blend, then the clip itself


class Extent(msgspec.Struct, frozen=True, kw_only=True):
    """How much of it is run.

    Attributes:
        stand_s, arms_s: How long it stands, and moves its arms [s].
        arm_seeds: One case each.
        push_standing_mps, push_waving_mps: Size of the pushes [m/s].
        push_directions: Evenly spread.
        push_instants: Pushes per direction, each in a run of its own, spread over the time of the wave.
        late_s: How much later targets are applied [s].
        cut_every_s: Distance of the instants at which each silence begins, within a clip [s].
    """

    stand_s: float = 600.0
    arms_s: float = 600.0
    arm_seeds: tuple[int, ...] = (1, 2)
    push_standing_mps: float = 0.4
    push_waving_mps: float = 0.3
    push_directions: int = 8
    push_instants: int = 6
    late_s: float = 0.02
    cut_every_s: float = 1.0


FULL = Extent()
QUICK = Extent(stand_s=60.0, arms_s=60.0, arm_seeds=(1,), push_instants=1, cut_every_s=6.0)


class Clips(msgspec.Struct, frozen=True, kw_only=True):
    """Durations of the clips that are there, by reference, and of the one that plays under pushes [s]."""

    durations_s: dict[str, float]
    wave_s: float


def cases(extent: Extent, clips: Clips, only: Collection[Group] = ()) -> list[Case]:
    """Return the cases of an extent, in the order of the table; those of some groups, or all."""
    made = [
        *_standing(extent),
        *_tracking(clips),
        *_pushes(extent, clips),
        *_late(extent, clips),
        *_cuts(extent, clips),
    ]
    return [case for group in LIMITS for case in made if case.group == group and (not only or group in only)]


def _standing(extent: Extent) -> Iterator[Case]:
    yield Stand(group="stand", seconds=extent.stand_s)
    for seed in extent.arm_seeds:
        yield Arms(group="arms", seconds=extent.arms_s, seed=seed)


def _tracking(clips: Clips) -> Iterator[Case]:
    for clip, duration_s in clips.durations_s.items():
        yield Track(group="unseen" if clip in HELD_BACK else "track", seconds=duration_s + 3.0, clip=clip)


def _pushes(extent: Extent, clips: Clips) -> Iterator[Case]:
    doing = (("", extent.push_standing_mps), (WAVING, extent.push_waving_mps))
    directions = [2.0 * math.pi * k / extent.push_directions for k in range(extent.push_directions)]
    for (clip, speed_mps), k, towards_rad in product(doing, range(extent.push_instants), directions):
        at_s = round(PUSH_FROM_S + k * clips.wave_s / extent.push_instants, 2)
        seconds = at_s + PUSH_SURVIVED_S
        yield Push(group="push", seconds=seconds, speed_mps=speed_mps, towards_rad=towards_rad, at_s=at_s, clip=clip)


def _late(extent: Extent, clips: Clips) -> Iterator[Case]:
    yield Stand(group="late", seconds=60.0, late_s=extent.late_s)
    for clip, duration_s in clips.durations_s.items():
        if "walk" in clip and "#" not in clip:
            yield Track(group="late", seconds=duration_s + 3.0, clip=clip, late_s=extent.late_s)


def _cuts(extent: Extent, clips: Clips) -> Iterator[Case]:
    """The silences take turns, so that together they begin three times as densely as each."""
    every_s = extent.cut_every_s
    for (clip, duration_s), (turn, silence) in product(clips.durations_s.items(), enumerate(SILENCES)):
        last_s = duration_s - (silence.seconds if silence.goes_on else 0.0)
        first_s = every_s * (turn + 0.5) / len(SILENCES)
        for k in range(math.ceil((last_s - first_s) / every_s)):
            at_s = first_s + k * every_s
            seconds = min(at_s, ENTER_S) + silence.seconds + AFTER_S
            yield Cut(group="gate", seconds=seconds, clip=clip, at_s=at_s, silence=silence)
