"""Whether the numbers of a state or command can be what their names and units say, each by itself.

Looked at are positions, angles, their rates and quaternions; counters and times may be NaN where nothing is known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from station.contract import Contract
from station.description import Joint, RobotDescription
from station.episode.quality.blocks import Block
from station.episode.quality.finding_parts import ValueFaults
from station.protocols import Floats

_SPATIAL = ("rad", "rad/s", "m", "m/s")
_POSITION = "_pos"
_TURN_RAD = 2.0 * math.pi
_BEYOND_RAD = 1.0  # of a joint that may turn further than once: as far beyond its end
_NORM = 0.01  # by which the length of a quaternion may differ from 1; float32 is off by 1e-7, a filter by 1e-3
_PARTS = "wxyz"


class ValueMeter:
    """Takes the blocks of one key.

    Args:
        start_ns: Instant that times are told from [ns since the epoch].
        description: Says how far joints turn; None where nothing does, and none turns more than once.
    """

    def __init__(self, start_ns: int, description: RobotDescription | None) -> None:
        self._start_ns = start_ns
        self._joints = {joint.name: joint for joint in description.joints} if description is not None else {}
        self._contract: Contract | None = None
        self._columns: list[int] = []
        self._angles: list[int] = []
        self._turns: Floats = np.empty(0)
        self._quaternions: list[list[int]] = []
        self._writes = self._unfit = self._not_finite = self._beyond = self._odd = 0
        self._first_ns: dict[str, int] = {}
        self._broken = self._beyond_name = ""
        self._beyond_rad, self._odd_norm = 0.0, 1.0

    def take(self, block: Block) -> None:
        """Add a block."""
        if self._contract != block.contract:
            self._contract = block.contract
            self._choose(block.contract)
        self._writes += len(block.times) + len(block.unfit)
        self._unfit += len(block.unfit)
        if len(block.unfit):
            self._first_ns.setdefault("unfit", int(block.unfit[0]))
        finite = np.isfinite(block.values[:, self._columns])
        if not finite.all():
            self._add_not_finite(block, finite)
        with np.errstate(all="ignore"):  # a damaged recording holds any number
            self._add_angles(block)
            for columns in self._quaternions:
                self._add_norms(block, np.linalg.norm(block.values[:, columns], axis=1))

    def result(self) -> ValueFaults | None:
        """Return what cannot be; None where everything can."""
        if self._contract is None or not (self._unfit or self._not_finite or self._beyond or self._odd):
            return None
        at_s = {what: round((at_ns - self._start_ns) * 1e-9, 3) for what, at_ns in self._first_ns.items()}
        return ValueFaults(
            key=self._contract.key,
            writes=self._writes,
            unfit=self._unfit,
            unfit_at_s=at_s.get("unfit"),
            not_finite=self._not_finite,
            not_finite_name=self._broken,
            not_finite_at_s=at_s.get("finite"),
            beyond_turn=self._beyond,
            beyond_turn_name=self._beyond_name,
            beyond_turn_rad=self._beyond_rad,
            beyond_turn_at_s=at_s.get("turn"),
            odd_quaternions=self._odd,
            odd_norm=self._odd_norm,
            odd_at_s=at_s.get("norm"),
        )

    def _choose(self, contract: Contract) -> None:
        names = contract.names
        self._quaternions = quaternions(names)
        turned = {column for columns in self._quaternions for column in columns}
        self._columns = [
            column for column, element in enumerate(contract.elements) if element.unit in _SPATIAL or column in turned
        ]
        self._angles = [
            column
            for column, element in enumerate(contract.elements)
            if element.unit == "rad" and element.name.endswith(_POSITION)
        ]
        self._turns = np.array([_turn(self._joints, names[column]) for column in self._angles])

    def _add_not_finite(self, block: Block, finite: Floats) -> None:
        rows = ~finite.all(axis=1)
        self._not_finite += int(rows.sum())
        if "finite" not in self._first_ns:
            row = int(rows.argmax())
            self._first_ns["finite"] = int(block.times[row])
            self._broken = block.contract.names[self._columns[int((~finite[row]).argmax())]]

    def _add_angles(self, block: Block) -> None:
        angles = np.abs(block.values[:, self._angles])
        beyond = (angles > self._turns) & np.isfinite(angles)
        rows = beyond.any(axis=1)
        if not rows.any():
            return
        self._beyond += int(rows.sum())
        self._first_ns.setdefault("turn", int(block.times[int(rows.argmax())]))
        greatest = np.where(beyond, angles, 0.0).max(axis=0)
        if greatest.max() > self._beyond_rad:
            self._beyond_rad = float(greatest.max())
            self._beyond_name = block.contract.names[self._angles[int(greatest.argmax())]]

    def _add_norms(self, block: Block, norms: Floats) -> None:
        odd = (np.abs(norms - 1.0) > _NORM) & np.isfinite(norms)
        if not odd.any():
            return
        self._odd += int(odd.sum())
        self._first_ns.setdefault("norm", int(block.times[int(odd.argmax())]))
        worst = float(norms[int(np.where(odd, np.abs(norms - 1.0), 0.0).argmax())])
        if abs(worst - 1.0) > abs(self._odd_norm - 1.0):
            self._odd_norm = worst


def quaternions(names: Sequence[str]) -> list[list[int]]:
    """Return the columns w, x, y, z of each quaternion among elements: names that end in ``quat_w`` … or ``qw`` …."""
    columns = {name: column for column, name in enumerate(names)}
    begins = [name[:-1] for name in names if name.endswith("quat_w") or name == "qw" or name.endswith("_qw")]
    found = [[columns.get(begin + part, -1) for part in _PARTS] for begin in begins]
    return [each for each in found if min(each) >= 0]


def _turn(joints: Mapping[str, Joint], name: str) -> float:
    """Return the angle that a joint cannot reach [rad]; one whose description knows no end may turn for ever."""
    joint = joints.get(name.removesuffix(_POSITION))
    if joint is None:
        return _TURN_RAD
    ends = [abs(end) for end in (joint.lower, joint.upper) if end is not None]
    return max(_TURN_RAD, max(ends) + _BEYOND_RAD) if len(ends) == 2 else math.inf
