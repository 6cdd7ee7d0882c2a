"""Motions on the spot: from posture to posture, feet where they are, weight over them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from adapters.motions.builtin.body import (
    STANDING_COM,
    STANDING_HEIGHT_M,
    STANDING_Q,
    Pose,
    first_beyond_range,
    from_roll_pitch_yaw,
    standing_feet,
)
from adapters.motions.builtin.profiles import rise, times
from adapters.motions.raw import RawMotion
from adapters.robots.g1.joints import G1_29, LEGS
from station.errors import ConfigError, UnknownName, UsageError
from station.protocols import Floats

RETURN_S = 1.0
"""Least time of the way back to standing [s]."""

SHORTEST_MOVE_S = 0.1
"""Least time from one posture to the next [s]; joints are too slow for less."""

_UPPER = G1_29[len(LEGS) :]


@dataclass(frozen=True, slots=True, kw_only=True)
class Posture:
    """Where the body shall be, and how long it takes to get there and stays.

    Attributes:
        move_s: Time of the way from the posture before [s].
        hold_s: Time in the posture [s].
        height: Of the pelvis above the floor [m].
        pitch, roll, yaw: Of the pelvis [rad]; pitch forward is positive.
        shift_x, shift_y: Of the weight (the centre of mass) from where it is when standing [m].
        joints: Positions of waist and arm joints [rad]; those not named are as in standing.
    """

    move_s: float = 1.0
    hold_s: float = 0.0
    height: float = STANDING_HEIGHT_M
    pitch: float = 0.0
    roll: float = 0.0
    yaw: float = 0.0
    shift_x: float = 0.0
    shift_y: float = 0.0
    joints: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (self.move_s >= SHORTEST_MOVE_S and self.hold_s >= 0.0):
            raise ConfigError(
                f"posture: move_s {self.move_s} and hold_s {self.hold_s}; expected at least {SHORTEST_MOVE_S:g} and 0 s"
            )

    def _upper(self) -> Floats:
        values = STANDING_Q[len(LEGS) :].copy()
        for name, value in self.joints.items():
            if name not in _UPPER:
                raise UnknownName("joint of waist and arms", name, _UPPER)
            values[_UPPER.index(name)] = value
        return values

    def _row(self) -> Floats:
        return np.array([self.height, self.roll, self.pitch, self.yaw, self.shift_x, self.shift_y, *self._upper()])


STANDING = Posture()


def postures(*ways: Posture, start_s: float = 0.5, end_s: float = 0.5, name: str = "postures") -> RawMotion:
    """Go from standing through postures and back to standing, at rest at each.

    Args:
        ways: The postures; unless the last one is standing, a way back of `RETURN_S` or the last `move_s` follows.
        start_s, end_s: Standing before and after [s].
        name: Of the motion.

    Raises:
        UsageError: no posture.
        ConfigError: a foot would be out of reach, or a joint at the end of its range.
        UnknownName: a joint that is none of waist and arms.
    """
    if not ways:
        raise UsageError(f"{name}: no posture to take; give at least one Posture")
    rows = [STANDING._row(), *(way._row() for way in ways)]
    spans = [(way.move_s, way.hold_s) for way in ways]
    if not np.array_equal(rows[-1], rows[0]):
        rows.append(rows[0])
        spans.append((max(ways[-1].move_s, RETURN_S), 0.0))
    time_s = times(start_s + end_s + sum(move + hold for move, hold in spans))
    values = np.repeat(rows[0][None], len(time_s), axis=0)
    begin_s = start_s
    for before, after, (move_s, hold_s) in zip(rows, rows[1:], spans, strict=False):
        values += rise(time_s, begin_s, begin_s + move_s)[:, None] * (after - before)
        begin_s += move_s + hold_s
    pose, q = _balanced(values)
    if (joint := first_beyond_range(q)) is not None:
        raise ConfigError(f"{name}: {joint} comes too near to an end of its range; ask for less")
    return pose.motion(name, q)


def _balanced(values: Floats) -> tuple[Pose, Floats]:
    """Keep the weight where the rows of `Posture._row` want it."""
    height, angles, shift, upper = values[:, 0], values[:, 1:4], values[:, 4:6], values[:, 6:]
    feet, feet_yaw = standing_feet(len(values))
    pelvis = np.column_stack([shift, height])
    return Pose(pelvis, from_roll_pitch_yaw(angles), feet, feet_yaw, upper).balanced(STANDING_COM[:2] + shift)
