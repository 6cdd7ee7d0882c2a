"""How the applied command lies beside the state that it was used with: by the clock, and by what the joints did.

By the clock: the instant at which the state of a step was read, less the instant at which its command was written.

By the joints: for each shift of k steps, the sum over steps and joints of (change of q in a step) times (change of the
command k steps before), divided by the roots of both sums of squares; the lag is where that is greatest, a parabola
through its neighbours giving parts of a step. Changes and not positions, so that an offset that stays says nothing.
Only runs of steps without a gap count, while the gate tracks. Where the squared changes of either side sum up to less
than 0.05 rad^2, or the two agree by less than a half, nothing is told.
"""

from __future__ import annotations

from array import array

import numpy as np

from station.bus import codec, contracts, keys
from station.episode.quality.finding_parts import Alignment
from station.episode.reading.steps import Step
from station.protocols import Floats

_STAGES = contracts.TIMING_STAGES
_FIRST_STAGE, _SEQ = 2, 1  # of a row of `keys.policy_timing`
_LARGEST = 1 << 62
_FOLLOWED = ("entering", "tracking")
_TRACKING = "tracking"
_BEFORE, _AFTER = 10, 25
"""Shifts that are tried: the state this many steps before its command, and after it."""
_BLOCK = 512
_LEAST_SUM = 0.05  # [rad^2]; a robot that stands sways by a hundredth of that in a minute
_LEAST_CORRELATION = 0.5


class AlignmentMeter:
    """Takes the steps of one robot."""

    def __init__(self, robot: str) -> None:
        self.robot = robot
        self._leads = array("q")
        self._times = array("q")
        self._sequence = 0
        self._repeated = self._skipped = 0
        self._names = {
            key: contract.names if (contract := contracts.contract(key)) is not None else ()
            for key in (keys.robot_state(robot), keys.command_used(robot))
        }
        self._pairs = _pairs(*self._names.values())
        self._shifts = _Shifts()
        self._last_number = 0

    def feed(self, step: Step, gate: str) -> None:
        """Take a step, and the state that the gate was in."""
        if gate in _FOLLOWED:
            self._take_timing(step)
        if step.number != self._last_number + 1 or gate != _TRACKING:
            self._shifts.cut()
        self._last_number = step.number
        if gate == _TRACKING:
            self._take_joints(step)

    def result(self) -> Alignment:
        """Return how commands lay beside states."""
        leads = np.frombuffer(self._leads, np.int64) * 1e-9
        p50, p99 = np.percentile(leads, (50, 99)).tolist() if len(leads) else (None, None)
        shift, correlation = self._shifts.result()
        intervals = np.diff(np.frombuffer(self._times, np.int64)) * 1e-9
        has_lag = shift is not None and len(intervals) > 0
        return Alignment(
            robot=self.robot,
            steps=len(leads),
            lead_p50_s=p50,
            lead_p99_s=p99,
            lead_least_s=float(leads.min()) if len(leads) else None,
            lead_max_s=float(leads.max()) if len(leads) else None,
            repeated=self._repeated,
            skipped=self._skipped,
            lag_s=shift * float(np.median(intervals)) if shift is not None and has_lag else None,
            lag_correlation=correlation if has_lag else None,
        )

    def _take_timing(self, step: Step) -> None:
        row = _row(step.values.get(keys.policy_timing(self.robot)))
        if row is None:
            return
        instants = dict(zip(_STAGES, row[_FIRST_STAGE:], strict=True))
        since = instants["command_written"] or instants["command_arrived"]
        if since > 0 and instants["state_read"] > 0:
            self._leads.append(instants["state_read"] - since)
        sequence = row[_SEQ]
        if self._sequence > 0 and sequence > 0:
            self._repeated += sequence == self._sequence
            self._skipped += min(max(0, sequence - self._sequence - 1), _LARGEST)
        self._sequence = sequence

    def _take_joints(self, step: Step) -> None:
        vectors = []
        for (key, names), columns in zip(self._names.items(), self._pairs, strict=True):
            data = step.values.get(key)
            if not names or data is None or len(data) != 8 * len(names):
                self._shifts.cut()
                return
            vectors.append(codec.parse_f64(data)[columns])
        self._times.append(step.at_ns)
        self._shifts.feed(*vectors)


class _Shifts:
    """Sums over runs of consecutive steps, for each shift."""

    def __init__(self) -> None:
        self._q: list[Floats] = []
        self._asked: list[Floats] = []
        self._sums = np.zeros(_BEFORE + _AFTER + 1)
        self._squares = np.zeros((2, len(self._sums)))

    def feed(self, q: Floats, asked: Floats) -> None:
        self._q.append(q)
        self._asked.append(asked)
        if len(self._q) >= _BLOCK:
            self.cut()

    def cut(self) -> None:
        """End the run; a block's end costs the few pairs that reach across it."""
        if len(self._q) > _BEFORE + _AFTER + 2:
            with np.errstate(all="ignore"):
                self._sum(np.diff(np.array(self._q), axis=0), np.diff(np.array(self._asked), axis=0))
        self._q, self._asked = [], []

    def _sum(self, moved: Floats, asked: Floats) -> None:
        whole = np.isfinite(moved).all() and np.isfinite(asked).all()
        middle = moved[_AFTER : len(moved) - _BEFORE]  # with a partner at every shift
        if not whole or not len(middle):
            return
        for place, shift in enumerate(range(-_BEFORE, _AFTER + 1)):
            partner = asked[_AFTER - shift : _AFTER - shift + len(middle)]
            self._sums[place] += float((middle * partner).sum())
            self._squares[:, place] += float((middle**2).sum()), float((partner**2).sum())

    def result(self) -> tuple[float | None, float | None]:
        """Return the shift at which both sides agree best [steps], and how well; None where nothing can be told."""
        self.cut()
        if not np.isfinite(self._squares).all() or self._squares.min() < _LEAST_SUM:
            return None, None
        agreement = self._sums / np.sqrt(self._squares[0] * self._squares[1])
        best = int(agreement.argmax())
        if agreement[best] < _LEAST_CORRELATION:
            return None, None
        return best - _BEFORE + _part(agreement, best), float(agreement[best])


def _part(values: Floats, best: int) -> float:
    """Return how far beside its greatest value a curve is highest, by a parabola through three points, -0.5 to 0.5."""
    if not 0 < best < len(values) - 1:
        return 0.0
    before, at, after = (float(value) for value in values[best - 1 : best + 2])
    bend = before - 2 * at + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0


def _pairs(state: tuple[str, ...], command: tuple[str, ...]) -> tuple[list[int], list[int]]:
    """Return the columns of the joints that state and command share."""
    shared = [name for name in state if name.endswith("_pos") and name in command]
    return [state.index(name) for name in shared], [command.index(name) for name in shared]


def _row(data: bytes | None) -> list[int] | None:
    """Return a row of `keys.policy_timing`, or None for what is none."""
    try:
        row = codec.parse_json(data) if data is not None else None
    except codec.BadValue:
        return None
    if not isinstance(row, list) or len(row) != _FIRST_STAGE + len(_STAGES):
        return None
    return row if all(type(number) is int and abs(number) < _LARGEST for number in row) else None
