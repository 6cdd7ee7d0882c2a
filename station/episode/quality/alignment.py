"""How the applied command lies beside the state that it was used with: by the clock, and by what the joints did.

By the clock: the instant at which the state of a step was read, less the instant at which its command was written.

By the joints: for each shift of k steps, the sum over steps and joints of (change of q in a step) times (change of the
command k steps before), divided by the roots of both sums of squares; the lag is where that is greatest, a parabola
through its neighbours giving parts of a step. Changes and not positions, so that an offset that stays says nothing.
Of several steps that saw the same recorded state, as those of an arm do whose states are written less often than it is
controlled, the first counts. Only runs without a gap count, while the gate tracks. Where the squared speeds of either
side, summed over time, are less than 0.086 rad^2/s per joint, or the two agree by less than a half, nothing is told.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from station.bus import codec, keys
from station.contract import TIMING_STAGES, Contract
from station.control.gate import MOVING
from station.episode.quality.finding_parts import Alignment
from station.episode.reading.steps import Step, timing_row
from station.protocols import Floats

_STAGES = TIMING_STAGES
_FIRST_STAGE, _SEQ = 2, 1  # of a row of `keys.policy_timing`
_LARGEST = 1 << 62
_TRACKING = "tracking"
_BEFORE_S, _AFTER_S = 0.2, 0.5
"""Shifts that are tried: the state so long before its command, and after it."""
_BLOCK, _MOST, _LEAST_RUN = 512, 128, 9  # samples: of a block; that are shifted by; of a run that tells the interval
_LEAST_MOTION = 2.5 / 29  # [rad^2/s], of a joint; a G1 that stands sways by a hundredth of that in a minute
_LEAST_CORRELATION = 0.5


class AlignmentMeter:
    """Takes the steps of one robot.

    Args:
        robot: Suffix of its keys.
        state_key: The state that its steps read.
        contract: Tells what a key holds.
    """

    def __init__(self, robot: str, state_key: str, contract: Callable[[str], Contract | None]) -> None:
        self.robot, self.state_key = robot, state_key
        self._leads = array("q")
        self._sequence = 0
        self._repeated = self._skipped = 0
        self._names = {
            key: found.names if (found := contract(key)) is not None else ()
            for key in (state_key, keys.command_used(robot))
        }
        self._pairs = _pairs(*self._names.values())
        self._shifts = _Shifts()
        self._last = (0, 0)  # numbers of the step before, and of the state that it saw

    def feed(self, step: Step, gate: str, heard: NDArray[np.bool_] | None = None) -> None:
        """Add a step, the state that the gate was in, and what the policy listens to, shape (m,); None for all."""
        if gate in MOVING:
            self._add_timing(step)
        if heard is not None and not heard[self._pairs[1]].any():
            gate = ""  # no joint of the command is followed
        (number, seen), self._last = self._last, (step.number, step.state_number)
        is_next = step.number == number + 1
        if gate != _TRACKING or not is_next or not 0 <= step.state_number - seen <= 1:
            self._shifts.cut()
        if gate == _TRACKING and not (is_next and step.state_number == seen):
            self._add_joints(step)

    def result(self) -> Alignment:
        """Return how commands lay beside states."""
        leads = np.frombuffer(self._leads, np.int64) * 1e-9
        p50, p99 = np.percentile(leads, (50, 99)).tolist() if len(leads) else (None, None)
        lag_s, correlation = self._shifts.result(joints=len(self._pairs[0]))
        return Alignment(
            robot=self.robot,
            state_key=self.state_key,
            steps=len(leads),
            lead_p50_s=p50,
            lead_p99_s=p99,
            lead_least_s=float(leads.min()) if len(leads) else None,
            lead_max_s=float(leads.max()) if len(leads) else None,
            repeated=self._repeated,
            skipped=self._skipped,
            lag_s=lag_s,
            lag_correlation=correlation,
        )

    def _add_timing(self, step: Step) -> None:
        row = timing_row(step.values.get(keys.policy_timing(self.robot)))
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

    def _add_joints(self, step: Step) -> None:
        vectors = []
        for (key, names), columns in zip(self._names.items(), self._pairs, strict=True):
            data = step.values.get(key)
            if not names or data is None or len(data) != 8 * len(names):
                self._shifts.cut()
                return
            vectors.append(codec.parse_f64(data)[columns])
        self._shifts.feed(step.at_ns, *vectors)


class _Shifts:
    """Sums over runs of consecutive samples, for each shift; how many shifts, their interval decides."""

    def __init__(self) -> None:
        self._times = array("q")
        self._begins = 0  # of the present run, in `_times`
        self._q: list[Floats] = []
        self._asked: list[Floats] = []
        self._before = self._after = 0
        self._sums = np.empty(0)
        self._squares = np.empty((2, 0))

    def feed(self, at_ns: int, q: Floats, asked: Floats) -> None:
        """Add a sample: positions measured and commanded, shape (n,) [rad]."""
        self._times.append(at_ns)
        self._q.append(q)
        self._asked.append(asked)
        if len(self._q) >= _BLOCK:
            self.cut()

    def cut(self) -> None:
        """End the run; a block's end costs the few pairs that reach across it."""
        if len(self._q) >= _LEAST_RUN and not len(self._sums):
            self._choose_shifts()
        if len(self._sums) and len(self._q) > len(self._sums) + 1:
            with np.errstate(all="ignore"):
                self._sum(np.diff(np.array(self._q), axis=0), np.diff(np.array(self._asked), axis=0))
        self._q, self._asked, self._begins = [], [], len(self._times)

    def _choose_shifts(self) -> None:
        """Choose how many are tried by the interval of the first run that has one."""
        interval_s = float(np.median(np.diff(np.array(self._times[self._begins :], np.int64)))) * 1e-9
        if interval_s > 0:
            self._before, self._after = (
                min(max(2, round(span_s / interval_s)), _MOST) for span_s in (_BEFORE_S, _AFTER_S)
            )
            self._sums = np.zeros(self._before + self._after + 1)
            self._squares = np.zeros((2, len(self._sums)))

    def _sum(self, moved: Floats, asked: Floats) -> None:
        whole = np.isfinite(moved).all() and np.isfinite(asked).all()
        middle = moved[self._after : len(moved) - self._before]  # with a partner at every shift
        if not whole or not len(middle):
            return
        for place in range(len(self._sums)):
            first = self._after + self._before - place
            partner = asked[first : first + len(middle)]
            self._sums[place] += float((middle * partner).sum())
            self._squares[:, place] += float((middle**2).sum()), float((partner**2).sum())

    def result(self, joints: int) -> tuple[float | None, float | None]:
        """Return the lag at which both sides agree best [s], and how well; None where nothing can be told."""
        self.cut()
        if not len(self._sums) or not np.isfinite(self._squares).all():
            return None, None
        interval_s = float(np.median(np.diff(np.frombuffer(self._times, np.int64)))) * 1e-9
        if not (interval_s > 0 and self._squares.min() > _LEAST_MOTION * joints * interval_s):
            return None, None
        agreement = self._sums / np.sqrt(self._squares[0] * self._squares[1])
        best = int(agreement.argmax())
        if agreement[best] < _LEAST_CORRELATION:
            return None, None
        return (best - self._before + _part(agreement, best)) * interval_s, float(agreement[best])


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
