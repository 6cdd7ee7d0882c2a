"""Whether states and commands stand at the times at which the policy steps say that they were there.

The steps of a policy carry instants of their machine's monotonic clock; the least distance between a step's write and
its last instant carries them over to the file's clock, to within the few milliseconds that a simulation needs for its
physics. Blocks of steps in which that distance varies by more than half a second (another clock) tell nothing.

* A state is written when it was read; a command when its writer stamped it. By what nine of ten differ at least, to the
  same side, the file's time of either is off.
* A command that was observed before it was written has a wrong time.
* The command after the gate is what its number says, or lags behind it where the gate bounds its rate. When it agrees
  with a command that came later, the two are shifted against each other.
* Each step has a state of its own, where the robot's server writes one at the start of every step. Those after the last
  state are not counted: a stream that ends is told elsewhere.
"""

from __future__ import annotations

from array import array
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from station.contract import TIMING_STAGES, Contract
from station.episode.quality.blocks import at_once, decoded
from station.episode.quality.finding_parts import Seen, StepTimes
from station.episode.reading.messages import Ints
from station.episode.reading.steps import timing_row
from station.protocols import Floats

_FIRST_STAGE, _SEQUENCE = 2, 1  # of a row of `keys.policy_timing`
_WRITTEN, _READ, _OBSERVED, _SENT = (
    _FIRST_STAGE + TIMING_STAGES.index(stage) for stage in ("command_written", "state_read", "observed", "sent")
)
_WRAP = 1 << 32  # of a number in the file
_OTHER_CLOCK_NS = 500_000_000
_LEAST_STEPS = 20
_MOST_AHEAD = 8  # commands
_DIFFERS, _SHARE = 2e-3, 0.3
"""From how great a mean difference on another command is looked for, and how much nearer that one has to be."""
_KEPT = 2 * _MOST_AHEAD + 50  # commands of one block that the next one may name

_decode_rows = msgspec.json.Decoder(list[list[int]]).decode
_LARGEST = 1 << 62


class Timed(NamedTuple):
    """A policy step: when its results were written, its recorded instants, the command after the gate, and its state.

    Attributes:
        at_ns: When its results were written [ns since the epoch].
        timing: Bytes of its instants; None where there are none.
        used: Bytes of the command after the gate, where that was tracking; else None.
        state_ns: When the state that it saw was written [ns since the epoch]; 0 for none.
        is_reused: Whether the step before saw the same state.
    """

    at_ns: int
    timing: bytes | None
    used: bytes | None
    state_ns: int
    is_reused: bool


class StepTimesMeter:
    """Takes the commands and the steps of one robot.

    Args:
        used, command: What the command after the gate holds, and what the key of the command does; None for neither, or
            where both do not hold the same elements.
        start_ns: Instant that times are told from [ns since the epoch].
    """

    def __init__(self, used: Contract | None, command: Contract | None, start_ns: int) -> None:
        self._start_ns, self._command_key = start_ns, command.key if command is not None else ""
        is_same = used is not None and command is not None and used.names == command.names
        self._used, self._command = (used, command) if is_same else (None, None)
        self._sources: set[str] = set()
        self._commands: dict[int, tuple[int, bytes]] = {}  # by number: when it was written, and what it holds
        self._states_off, self._commands_off = array("q"), array("q")
        self._reused_ns = 0
        self._untimed = array("q")
        self._steps = self._early = self._stamped = self._reused = self._again = self._compared = self._timed = 0
        self._distance = np.zeros(_MOST_AHEAD + 1)

    def add_command(self, source: str, number: int, at_ns: int, data: bytes) -> None:
        """Add a command; those of several writers have numbers of their own, and none is looked up then."""
        if source not in self._sources and len(self._sources) < 2:
            self._sources.add(source)
        self._commands[number] = at_ns, data

    def take(self, steps: list[Timed]) -> None:
        """Add steps, and forget the commands before them."""
        for step in steps:
            self._steps += step.state_ns > 0
            self._again = self._again + 1 if step.is_reused else 0
            if step.is_reused and not self._reused:
                self._reused_ns = step.at_ns
            self._reused += step.is_reused
        timed = [step for step in steps if step.timing is not None]
        rows = _rows([step.timing or b"" for step in timed])
        good = np.flatnonzero(rows[:, _SENT] > 0)
        self._untimed.extend(timed[index].at_ns for index in np.flatnonzero((rows[:, _FIRST_STAGE:] <= 0).all(axis=1)))
        self._timed += len(timed)
        if len(good):
            self._compare(rows[good], [timed[index] for index in good])
        for number in list(self._commands)[:-_KEPT]:
            del self._commands[number]

    def result(self) -> StepTimes | None:
        """Return how times lie to each other; None where too little says when anything was."""
        state_s, command_s = (_off_s(off) for off in (self._states_off, self._commands_off))
        ahead, differs = self._ahead()
        first_s = round((self._untimed[0] - self._start_ns) * 1e-9, 3) if self._untimed else None
        if self._steps < _LEAST_STEPS:
            return None
        return StepTimes(
            steps=self._steps,
            state_off_s=state_s,
            command_off_s=command_s,
            before_written_share=self._early / self._stamped if self._stamped else 0.0,
            commands_ahead=ahead,
            command_difference=differs,
            reused_states_share=(self._reused - self._again) / self._steps,
            reused_at_s=round((self._reused_ns - self._start_ns) * 1e-9, 3) if self._reused else None,
            command_key=self._command_key,
            untimed=Seen(len(self._untimed), first_s),
            timed=self._timed,
        )

    def _compare(self, rows: Ints, steps: list[Timed]) -> None:
        at_ns = np.fromiter((step.at_ns for step in steps), np.int64, len(steps))
        apart = at_ns - rows[:, _SENT]
        stamped = rows[:, _WRITTEN] > 0
        self._stamped += int(stamped.sum())
        self._early += int((stamped & (rows[:, _OBSERVED] > 0) & (rows[:, _WRITTEN] > rows[:, _OBSERVED])).sum())
        if np.ptp(apart) > _OTHER_CLOCK_NS:
            return
        states_ns = np.fromiter((step.state_ns for step in steps), np.int64, len(steps))
        seen = (states_ns > 0) & (rows[:, _READ] > 0)
        self._states_off.frombytes((states_ns - rows[:, _READ] - apart.min())[seen].tobytes())
        if len(self._sources) == 1 and self._commands:
            self._look_up(rows, steps, int(apart.min()))

    def _look_up(self, rows: Ints, steps: list[Timed], apart_ns: int) -> None:
        numbers = np.array(sorted(self._commands), dtype=np.int64)
        asked = rows[:, _SEQUENCE] % _WRAP
        known = np.isin(asked, numbers) & (rows[:, _WRITTEN] > 0)
        times = np.array([self._commands[int(number)][0] for number in asked[known]], dtype=np.int64)
        self._commands_off.frombytes((times - rows[known, _WRITTEN] - apart_ns).tobytes())
        if self._used is None or self._command is None:
            return
        ahead = np.arange(_MOST_AHEAD + 1)
        tracking = np.array([step.used is not None for step in steps], dtype=np.bool_)
        whole = known & tracking & np.isin(asked[:, None] + ahead, numbers).all(axis=1)
        values, fits = decoded(self._command, [self._commands[int(number)][1] for number in numbers])
        applied, of_steps = decoded(self._used, [steps[index].used or b"" for index in np.flatnonzero(whole)])
        if not fits.all() or not of_steps.all() or not len(applied):
            return
        places = np.searchsorted(numbers, asked[whole])
        with np.errstate(all="ignore"):
            distance = np.array([np.abs(applied - values[places + shift]).mean() for shift in ahead])
        if np.isfinite(distance).all():
            self._distance += distance * len(applied)
            self._compared += len(applied)

    def _ahead(self) -> tuple[int, float | None]:
        if self._compared < _LEAST_STEPS:
            return 0, None
        distance: Floats = self._distance / self._compared
        best = int(distance.argmin())
        is_ahead = distance[0] > _DIFFERS and distance[best] < _SHARE * distance[0]
        return best if is_ahead else 0, float(distance[0])


def _rows(data: list[bytes]) -> NDArray[np.int64]:
    """Return rows of instants, shape (k, 8); zeros for what is none."""
    width = _FIRST_STAGE + len(TIMING_STAGES)
    found = at_once(_decode_rows, data)
    if found is None or not all(len(row) == width and all(abs(one) < _LARGEST for one in row) for row in found):
        found = [timing_row(value) or [0] * width for value in data]
    return np.array(found, dtype=np.int64).reshape(len(data), width)


def _off_s(values: array[int]) -> float | None:
    """Return by how much nine of ten are off at least, to the same side [s]; 0 where they are not."""
    if len(values) < _LEAST_STEPS:
        return None
    low, high = np.percentile(np.frombuffer(values, np.int64), (10, 90)).tolist()
    return float(max(low, 0.0) + min(high, 0.0)) * 1e-9
