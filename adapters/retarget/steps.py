"""Where and when feet are put down, decided while walking: the steps to come are planned anew in every tick.

A step begins with both feet on the floor, lifts one, and ends where that foot lands. The weight (ZMP) goes onto the
foot that stays before the other one is lifted. Pure: time comes as arguments.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from adapters.motions.builtin.body import STANDING_COM, STANDING_FEET, turned
from adapters.motions.builtin.footsteps import foothold
from adapters.motions.builtin.profiles import bump, rise
from station.protocols import Floats

STEP_S = 0.45
"""From one footfall to the next [s]; as in `adapters.motions.builtin.plan.WalkPlan`."""

DOUBLE_S = 0.09
"""Of it, with both feet on the floor [s]."""

SWING_S = STEP_S - DOUBLE_S
"""A foot in the air [s]."""

SHIFT_S = 0.4
"""From standing on both feet to the first lift, and back after the last footfall [s]."""

CARRIES_S = STEP_S + DOUBLE_S
"""From the landing of a foot to its lift [s]."""

STILL = 1e-3
"""A slower body stands [m/s, rad/s]."""

_DECIDED_S = 0.7 * SWING_S  # after so long in the air a foot goes where it was going: it must not slide as it lands
_WAIT_S = 0.1  # before the weight begins to move: the pendulum leans ahead of it, and shall not start with a kick
_CLEAR_OF_EACH_OTHER_M = 0.15  # between the two ankles, sideways; the feet are 7 cm wide
_STANDING_WIDTH_M = float(STANDING_FEET[0, 1] - STANDING_FEET[1, 1])
_WALKING_WIDTH_M = 0.22
_PRESSED_M = np.array([STANDING_COM[0] - STANDING_FEET[0, 0], 0.0])  # what carries of a sole, from its ankle


@dataclass(frozen=True, slots=True)
class _Swing:
    """The foot that is in the air, or is the next to be: 0 left, 1 right."""

    side: int
    lift_s: float  # when it is lifted, from now; negative for a foot in the air
    shift_s: float  # how long before that the weight begins to move
    settles: bool  # whether it is put down to stand
    place: Floats | None = None  # where it will land, once that is decided


class Steps:
    """Two feet that follow a body: standing, stepping one by one, and coming together again.

    Attributes:
        place: Where the body wishes to be: x, y [m] and heading [rad].
        feet: Where the feet stand, or were lifted: x, y [m] and heading [rad], shape (2, 3).
        phase: What is going on; "settling" is the way of the weight back between the feet.
    """

    def __init__(self) -> None:
        self.place = np.zeros(3)
        self.feet = np.array([foothold(self.place, side, _STANDING_WIDTH_M) for side in (0, 1)])
        self.phase: Literal["standing", "stepping", "settling"] = "standing"
        self._velocity = np.zeros(3)
        self._swing = _Swing(0, 0.0, 0.0, settles=False)
        self._settled = 0  # feet that have been put down to stand, one after the other
        self._settling_s = 0.0
        self._from = _between(self.feet)  # where the weight was before it began to go where it goes now

    @property
    def may_move(self) -> bool:
        """Whether the body may have a velocity: only once the first foot is in the air."""
        return self.phase == "stepping" and (self._swing.lift_s <= 0.0 or self._swing.shift_s < SHIFT_S)

    def advance(self, dt_s: float, velocity: Floats, wish: Floats) -> None:
        """Go on for a period [s].

        Args:
            dt_s: The period.
            velocity: Of the body now, forward, to the left [m/s] and turning left [rad/s]; zero unless `may_move`.
            wish: The velocity that it is on the way to; zero asks it to stand.
        """
        self._velocity = velocity
        self.place = moved(self.place, velocity, dt_s)
        if self.phase == "stepping":
            self._swing_on(dt_s, wish)
        elif self.phase == "settling":
            self._settling_s += dt_s
            if self._settling_s >= SHIFT_S:
                self.phase, self._from = "standing", _between(self.feet)
        elif is_moving(wish):
            self._set_out(wish)

    def ankles(self, clearance: float) -> tuple[Floats, Floats]:
        """Return positions of the ankle_roll links, shape (2, 3) [m], and their headings, shape (2,) [rad]."""
        position = np.column_stack([self.feet[:, :2], STANDING_FEET[:, 2]])
        yaw = self.feet[:, 2].copy()
        swing = self._swing
        if self.phase == "stepping" and swing.lift_s < 0.0:
            now = np.zeros(1)
            way = self._landing(swing, self.feet[1 - swing.side]) - self.feet[swing.side]
            way *= rise(now, swing.lift_s, swing.lift_s + SWING_S)[0]
            position[swing.side, :2] += way[:2]
            position[swing.side, 2] += clearance * bump(now, swing.lift_s, swing.lift_s + SWING_S)[0]
            yaw[swing.side] += way[2]
        return position, yaw

    def weight(self, ahead_s: Floats) -> Floats:
        """Return where the floor will push (the ZMP) at times from now, as planned now, shape (n, 2) [m]."""
        points = np.repeat(self._from[None], len(ahead_s), axis=0)
        if self.phase == "settling":
            begin_s = -self._settling_s
            points += rise(ahead_s, begin_s, begin_s + SHIFT_S)[:, None] * (_between(self.feet) - self._from)
        elif self.phase == "stepping":
            self._shift(points, ahead_s)
        return points

    def _shift(self, points: Floats, ahead_s: Floats) -> None:
        """Let the weight go from foot to foot, and at the end between them."""
        swing, feet, at, settled = self._swing, self.feet.copy(), self._from, self._settled
        while swing.lift_s - swing.shift_s < ahead_s[-1]:
            is_last = settled >= 2
            on = _between(feet) if is_last else _pressed(feet[1 - swing.side])
            points += rise(ahead_s, swing.lift_s - swing.shift_s, swing.lift_s)[:, None] * (on - at)
            if is_last:
                return
            feet[swing.side] = self._landing(swing, feet[1 - swing.side])
            at, settled = on, settled + swing.settles
            shift_s = SHIFT_S if settled >= 2 else DOUBLE_S
            swing = _Swing(1 - swing.side, swing.lift_s + SWING_S + shift_s, shift_s, swing.settles)

    def _set_out(self, wish: Floats) -> None:
        """Begin to walk: outwards first, so that feet do not cross."""
        outward = wish[1] if abs(wish[1]) > STILL else wish[2]
        self.phase, self._settled = "stepping", 0
        self._swing = _Swing(0 if outward >= 0.0 else 1, SHIFT_S + _WAIT_S, SHIFT_S, settles=False)

    def _swing_on(self, dt_s: float, wish: Floats) -> None:
        is_still = not is_moving(wish) and not is_moving(self._velocity)
        swing = replace(self._swing, lift_s=self._swing.lift_s - dt_s)
        if swing.lift_s > 0.0:
            swing = replace(swing, settles=is_still)
        if swing.lift_s <= -SWING_S:
            swing = self._put_down(swing, is_still=is_still)
        elif swing.lift_s <= -_DECIDED_S and swing.place is None:
            swing = replace(swing, place=self._landing(swing, self.feet[1 - swing.side]))
        self._swing = swing

    def _put_down(self, swing: _Swing, *, is_still: bool) -> _Swing:
        """Land; return the next step."""
        late_s = -SWING_S - swing.lift_s
        self.feet[swing.side] = self._landing(swing, self.feet[1 - swing.side])
        self._from = _pressed(self.feet[1 - swing.side])
        self._settled = self._settled + 1 if swing.settles and is_still else 0
        if self._settled >= 2:
            self.phase, self._settling_s = "settling", late_s
        return _Swing(1 - swing.side, DOUBLE_S - late_s, DOUBLE_S, settles=is_still)

    def _landing(self, swing: _Swing, other: Floats) -> Floats:
        """Where a foot will land: below the body, half way through the time that it will carry."""
        if swing.place is not None:
            return swing.place
        passed_s = swing.lift_s + SWING_S + CARRIES_S / 2.0
        width = _STANDING_WIDTH_M if swing.settles else _WALKING_WIDTH_M
        return _apart(foothold(moved(self.place, self._velocity, passed_s), swing.side, width), other, swing.side)


def is_moving(velocity: Floats) -> bool:
    """Whether a velocity is more than nothing."""
    return bool((np.abs(velocity) > STILL).any())


def moved(place: Floats, velocity: Floats, dt_s: float) -> Floats:
    """Return where a body at a place is after a time at a velocity [m/s, m/s, rad/s]: along an arc."""
    turn = float(velocity[2]) * dt_s
    chord = turned(velocity[:2] * dt_s * np.sinc(turn / (2.0 * np.pi)), place[2] + turn / 2.0)
    return np.asarray(place + np.append(chord, turn))


def _apart(place: Floats, other: Floats, side: int) -> Floats:
    """Move a foothold sideways until it is clear of the other foot."""
    heading = (place[2] + other[2]) / 2.0
    outward = (1 - 2 * side) * np.array([-np.sin(heading), np.cos(heading)])
    missing = _CLEAR_OF_EACH_OTHER_M - float((place[:2] - other[:2]) @ outward)
    return np.asarray(place + np.append(max(missing, 0.0) * outward, 0.0))


def _pressed(foot: Floats) -> Floats:
    """The point of a sole that carries, for a foot at x, y and heading; as far forward as when standing."""
    return np.asarray(foot[:2] + turned(_PRESSED_M, foot[2]))


def _between(feet: Floats) -> Floats:
    return np.asarray((_pressed(feet[0]) + _pressed(feet[1])) / 2.0)
