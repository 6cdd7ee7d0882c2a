"""What a policy promises: the limits, and the cases that they are held against. One screen, and nothing else counts."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from itertools import product

import msgspec

from station.control.gate import GateConfig
from station.protocols import Floats
from station.suite.attacks import ATTACKS
from station.suite.cases import (
    STILL,
    Arms,
    Attacked,
    Case,
    Cease,
    Cut,
    Group,
    HandOver,
    Push,
    Silence,
    Stand,
    Track,
    Velocity,
    Walk,
)  # fmt: skip

LIMITS: dict[Group, str] = {
    "stand": "no fall, and no further drift or turn than the policy it is held against",
    "track": "no fall, mean |joint error| at most 0.10 rad",
    "unseen": "no fall, mean |joint error| at most 0.10 rad",
    "follow": "no fall, and at least 0.3 of each velocity that is asked for",
    "push": "no fall within 5 s",
    "arms": "no fall",
    "late": "no fall",
    "gate": "no fall; a velocity fades to zero within 0.32 s, in steps of at most 0.15 of it",
    "envelope": "no fall, whatever is commanded",
    "hand-over": "no fall, none refused, and targets that jump no more than 1.5 times as far as else, or as joints can",
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

FOLLOWED = 0.3
"""Least share of each commanded velocity that is measured, as a mean over the stretch: it goes where it is sent."""

ZERO_AFTER_S, FADE_STEP = 0.32, 0.15
"""Latest time from the last command to a velocity of zero [s], and its greatest step on the way, as a share of it."""

JUMPS = 1.5
"""How much further than without a hand-over a target may step in one, where that is more than the joint can move."""

STARTS_S, WALKED_S, RESTS_S = 2.0, 8.0, 3.0
"""A robot that is to follow a velocity first stands, then walks, then stands [s]."""

CEASES_S, COMES_BACK_S, WALKS_ON_S = 8.0, 13.0, 5.0
"""When commands cease and come back, and how long it walks after that [s]."""

STRIDES_S = 1.0
"""Pushes of a robot that walks are spread over so long [s]."""

TURN_EVERY_S, TURNS = 1.5, 12
"""Policies take over from each other so often [s], and so many times."""

WAVING = "builtin:wave"
"""Played under pushes."""

_GATE = GateConfig()
SILENCES = (
    Silence("holding", 2.0 * _GATE.hold_after_s, goes_on=True),
    Silence("returning", 0.5 * _GATE.blend_out_s, goes_on=True),
    Silence("standing", _GATE.return_after_s + _GATE.blend_out_s + 1.0, goes_on=False),
)

ATTACKED_S = 8.0
"""How long an attack lasts [s]; its last command is held for a second more."""

PUSH_FROM_S, PUSH_SURVIVED_S = 3.0, 5.0  # the robot has settled by then; a fall after a push takes no longer
ENTER_S, AFTER_S = 2.0, 4.0  # each a second of blend, then the clip itself


class Extent(msgspec.Struct, frozen=True, kw_only=True):
    """How much of it is run.

    Attributes:
        stand_s, arms_s: How long it stands, and moves its arms [s].
        arm_seeds: One case each.
        push_standing_mps, push_waving_mps: Size of the pushes [m/s]; the second one also while it walks.
        push_directions: Evenly spread.
        push_instants: Pushes per direction, each in a run of its own, spread over the time of the wave, or strides.
        late_s: How much later targets are applied [s].
        cut_every_s: Distance of the instants at which each silence begins, within a clip [s].
        attacks: Streams of wild commands, of all kinds in turn.
        shares: How much of the range that a policy was trained on is asked for, of one that follows velocities.
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
    attacks: int = 140
    shares: tuple[float, ...] = (0.5, 1.0)


FULL = Extent()
QUICK = Extent(stand_s=60.0, arms_s=60.0, arm_seeds=(1,), push_instants=1, cut_every_s=6.0, attacks=14, shares=(0.5,))


class Clips(msgspec.Struct, frozen=True, kw_only=True):
    """Durations of the clips that are there, by reference, and of the one that plays under pushes [s]."""

    durations_s: dict[str, float]
    wave_s: float


def cases(extent: Extent, clips: Clips, only: Collection[Group] = ()) -> list[Case]:
    """Return the cases of an extent, in the order of the table; those of some groups, or all."""
    made = [
        *_standing(extent),
        *_tracking(clips),
        *_pushes(
            extent, [("", STILL, extent.push_standing_mps), (WAVING, STILL, extent.push_waving_mps)], clips.wave_s
        ),
        *_late(extent, clips),
        *_cuts(extent, clips),
        *_attacks(extent, tuple(clips.durations_s)),
    ]
    return [case for group in LIMITS for case in made if case.group == group and (not only or group in only)]


def velocity_cases(
    extent: Extent, lower: Floats, upper: Floats, only: Collection[Group] = (), hand_over: tuple[str, str] = ("", "")
) -> list[Case]:
    """Return the cases of a policy that follows velocities, in the order of the table.

    Args:
        extent: How much.
        lower, upper: Range of the velocities, shape (3,).
        only: Some of the groups; none for all.
        hand_over: Family and file of the policy that takes turns with it; "" for itself.
    """
    first = extent.shares[0]
    ahead, turning = (_velocity(upper, first, axis) for axis in ([0], [2]))
    curve, other_curve = _velocity(upper, first, [0, 2]), (float(first * upper[0]), 0.0, float(first * lower[2]))
    walk_s = STARTS_S + WALKED_S + RESTS_S
    asked = [
        *(_velocity(end, share, [axis]) for share, axis, end in product(extent.shares, range(3), (upper, lower))),
        curve, other_curve,
    ]  # fmt: skip
    cease_s, turns_s = COMES_BACK_S + WALKS_ON_S, TURN_EVERY_S * (TURNS + 1)
    policy, checkpoint = hand_over
    made: list[Case] = [
        Stand(group="stand", seconds=extent.stand_s),
        *(Walk(group="follow", seconds=walk_s, velocity=each) for each in dict.fromkeys(asked) if any(each)),
        *_pushes(extent, [("", STILL, extent.push_standing_mps), ("", ahead, extent.push_waving_mps)], STRIDES_S),
        *_attacks(extent),
        Stand(group="late", seconds=60.0, late_s=extent.late_s),
        *(Walk(group="late", seconds=walk_s, velocity=each, late_s=extent.late_s) for each in (ahead, curve)),
        *(Cease(group="gate", seconds=cease_s, velocity=each) for each in (ahead, turning, curve)),
        *(
            HandOver(group="hand-over", seconds=turns_s, velocity=each, policy=policy, checkpoint=checkpoint)
            for each in (STILL, ahead, curve)
        ),
    ]
    return [case for group in LIMITS for case in made if case.group == group and (not only or group in only)]


def _velocity(end: Floats, share: float, axes: Collection[int]) -> Velocity:
    """Return a share of an end of the range, along some axes."""
    vx, vy, wz = (float(share * value) if axis in axes else 0.0 for axis, value in enumerate(end))
    return vx, vy, wz


def _standing(extent: Extent) -> Iterator[Case]:
    yield Stand(group="stand", seconds=extent.stand_s)
    for seed in extent.arm_seeds:
        yield Arms(group="arms", seconds=extent.arms_s, seed=seed)


def _tracking(clips: Clips) -> Iterator[Case]:
    for clip, duration_s in clips.durations_s.items():
        yield Track(group="unseen" if clip in HELD_BACK else "track", seconds=duration_s + 3.0, clip=clip)


def _pushes(extent: Extent, doing: Collection[tuple[str, Velocity, float]], spread_s: float) -> Iterator[Case]:
    """Yield pushes of a size [m/s] while a clip plays or a velocity is followed, their instants over some time [s]."""
    directions = [2.0 * math.pi * k / extent.push_directions for k in range(extent.push_directions)]
    for (clip, velocity, speed_mps), k, towards_rad in product(doing, range(extent.push_instants), directions):
        at_s = round(PUSH_FROM_S + k * spread_s / extent.push_instants, 2)
        yield Push(
            group="push", seconds=at_s + PUSH_SURVIVED_S, speed_mps=speed_mps, towards_rad=towards_rad, at_s=at_s,
            clip=clip, velocity=velocity,
        )  # fmt: skip


def _attacks(extent: Extent, clips: tuple[str, ...] = ()) -> Iterator[Case]:
    """Yield attacks of all kinds; without clips those that need none."""
    kinds = ATTACKS if clips else [kind for kind in ATTACKS if kind != "frames"]
    for seed in range(extent.attacks):
        yield Attacked(
            group="envelope", seconds=ATTACKED_S + 1.0, attack=kinds[seed % len(kinds)], seed=seed, clips=clips
        )


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
