"""Whether joints follow their own commands, or each other's: names that were exchanged, signs, and zeros that are off.

Over the steps that follow a command: the correlation of each joint's position with each joint's command, and the root
of the mean squared distance of both. A joint is out of place where it hardly goes with its own command (below 0.5),
goes with that of another (above 0.6), and is at most 0.6 times as far from that as from its own. Both have to move, and
both have to be out of place: names that were exchanged are exchanged among themselves.

A joint that goes with the negative of its own command (below -0.7) has the wrong sign. One that goes with its command
(above 0.6), and stays beside it by an angle that varies by less than half of itself, has another zero. One that does
not says nothing: a policy may leave joints of its command alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from station.episode.quality.finding_parts import MisplacedJoint
from station.protocols import Floats

_MOVES_RAD = 0.05  # standard deviation of a joint, and of its command
_LEAST_STEPS = 50
_OWN, _OTHER, _NEARER = 0.5, 0.6, 0.6
_AGAINST = -0.7
_STEADY = 0.5  # of an offset, that it may vary by
_LEAST_OFFSET_RAD = 0.05


class JointOrderMeter:
    """Takes positions and commands of n joints.

    Args:
        joints: Their names.
    """

    def __init__(self, joints: list[str]) -> None:
        count = len(joints)
        self._joints = joints
        self._origin: Floats | None = None
        self._steps = 0
        self._sums = np.zeros((2, count))
        self._squares = np.zeros((2, count))
        self._products = np.zeros((count, count))

    def take(self, q: Floats, asked: Floats) -> None:
        """Add positions and commands, shape (k, n) [rad]; rows that are not finite are left out."""
        good = np.isfinite(q).all(axis=1) & np.isfinite(asked).all(axis=1)
        if not good.any() or not self._joints:
            return
        if self._origin is None:
            self._origin = asked[good][0]  # of both, so that distances stay and sums stay small
        q, asked = q[good] - self._origin, asked[good] - self._origin
        self._steps += len(q)
        with np.errstate(all="ignore"):  # a damaged recording holds any number
            self._sums += q.sum(axis=0), asked.sum(axis=0)
            self._squares += (q**2).sum(axis=0), (asked**2).sum(axis=0)
            self._products += q.T @ asked

    def misplaced(self) -> list[MisplacedJoint]:
        """Return the joints that follow another one's command; none where fewer than two do."""
        if self._steps < _LEAST_STEPS or self._origin is None:
            return []
        moves, agreement = self._agreement()
        with np.errstate(all="ignore"):
            distance = np.sqrt(np.maximum(self._distances(), 0.0))
        agreement = np.where(np.isfinite(agreement), agreement, -1.0)
        found = []
        for joint in np.flatnonzero(moves).tolist():
            other = int(agreement[joint].argmax())
            own = agreement[joint, joint]
            nearer = distance[joint, other] < _NEARER * distance[joint, joint]
            if other != joint and own < _OWN and agreement[joint, other] > _OTHER and nearer:
                names = self._joints[joint], self._joints[other]
                found.append(MisplacedJoint(*names, float(own), float(agreement[joint, other])))
        while len(inside := [each for each in found if each.follows in {one.joint for one in found}]) < len(found):
            found = inside
        return found

    def reversed(self) -> dict[str, float]:
        """Return the joints that move against their own commands, and how far both agree."""
        if self._steps < _LEAST_STEPS:
            return {}
        moves, agreement = self._agreement()
        own = np.diag(agreement)
        return {self._joints[joint]: float(own[joint]) for joint in np.flatnonzero(moves & (own < _AGAINST))}

    def offsets_rad(self) -> dict[str, float]:
        """Return by what angle joints that follow their own commands stay beside them, the greatest first [rad]."""
        if self._steps < _LEAST_STEPS:
            return {}
        _, agreement = self._agreement()
        with np.errstate(all="ignore"):
            mean = (self._sums[0] - self._sums[1]) / self._steps
            square = (self._squares.sum(axis=0) - 2.0 * np.diag(self._products)) / self._steps
            varies = np.sqrt(np.maximum(square - mean**2, 0.0))
            follows = np.diag(agreement) > _OTHER
        steady = follows & (varies < _STEADY * np.abs(mean)) & (np.abs(mean) > _LEAST_OFFSET_RAD)
        order = sorted(np.flatnonzero(steady).tolist(), key=lambda joint: -abs(float(mean[joint])))
        return {self._joints[joint]: round(float(mean[joint]), 4) for joint in order}

    def _agreement(self) -> tuple[NDArray[np.bool_], Floats]:
        """Return which joints moved with their commands, and the correlation of each with each command, else NaN."""
        with np.errstate(all="ignore"):
            means = self._sums / self._steps
            spread = np.sqrt(np.maximum(self._squares / self._steps - means**2, 0.0))
            agreement = (self._products / self._steps - np.outer(means[0], means[1])) / np.outer(spread[0], spread[1])
        moves = np.asarray((spread > _MOVES_RAD).all(axis=0))
        return moves, np.where(np.outer(moves, moves), agreement, np.nan)

    def _distances(self) -> Floats:
        """Return the mean squared distance of each joint from each joint's command, in radians of their own zero."""
        assert self._origin is not None
        shift = np.subtract.outer(self._origin, self._origin)  # q_j + o_j - (c_k + o_k)
        means = self._sums / self._steps
        squares = self._squares / self._steps
        apart = np.subtract.outer(means[0], means[1])
        plain = squares[0][:, None] + squares[1][None, :] - 2 * self._products / self._steps
        return np.asarray(plain + 2 * shift * apart + shift**2)
