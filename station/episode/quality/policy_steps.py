"""Latency, gate and tracking error over the policy steps of one robot."""

from __future__ import annotations

import sys
from array import array
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from station import rotations
from station.bus import codec, contracts, keys
from station.bus.robot_streams import QUAT
from station.contract import TIMING_STAGES, Contract
from station.control.gate import MOVING
from station.control.tracking import TrackingError, VelocityTracking
from station.episode.quality import falls
from station.episode.quality.finding_parts import Seen
from station.episode.quality.findings import FallSeen, Spread, StepQuality
from station.episode.quality.pauses import Span
from station.episode.reading.steps import RESULTS, Step, timing_row
from station.protocols import Floats

_STAGES = TIMING_STAGES
_FIRST_STAGE = 2  # after tick and command_seq
_TRACKING = "tracking"
_PLAYING = "playing"
_HEIGHT = "root_z"
_PLACE = ("root_x", "root_y", _HEIGHT, *QUAT)
_MOST_LACKING = 0.2  # of the steps; a key that more of them lack is written when it likes, or is not there to the end


@dataclass
class StepMeter:
    """Takes the steps of one robot and tells at the end what they were like.

    Attributes:
        robot: Suffix of its keys.
        start_ns: Instant that times are told from [ns since the epoch].
        contract: Tells what a key holds.
        period_s: Control period, as its server stated it [s]; None where it did not.
        listens: Name of the part of the command that each policy listens to, by what its steps call the policy; those
            that listen to all of it are not in it.
        heard: Which elements of the command the policy of the newest step listens to, shape (m,); None for all.
    """

    robot: str
    start_ns: int
    contract: Callable[[str], Contract | None] = contracts.contract
    period_s: float | None = None
    listens: Mapping[str, str] = field(default_factory=dict)
    heard: NDArray[np.bool_] | None = None
    _times: array[int] = field(default_factory=lambda: array("q"))
    _gates: list[str] = field(default_factory=list)
    _timed: array[int] = field(default_factory=lambda: array("q"))  # the steps of _timings, by number in _gates
    _timings: array[int] = field(default_factory=lambda: array("q"))  # row after row
    _numbers: dict[str, array[int]] = field(default_factory=lambda: defaultdict(lambda: array("q")))
    _poses: dict[str, bytearray] = field(default_factory=lambda: defaultdict(bytearray))
    _pose_times: dict[str, array[int]] = field(default_factory=lambda: defaultdict(lambda: array("q")))
    _tracking: TrackingError | None = None
    _velocity: VelocityTracking | None = None
    _joints: tuple[str, ...] = ()
    _counts: dict[str, int] = field(default_factory=dict)
    _held: dict[frozenset[str], list[int]] = field(
        default_factory=dict
    )  # by the keys of steps: how many, the first [ns]

    def __post_init__(self) -> None:
        self._layouts = {
            key: contract.names
            for family in (keys.command_used, keys.robot_state, keys.sim_qpos, keys.state_joints)
            if (contract := self.contract(key := family(self.robot))) is not None
        }
        asked = self._layouts.get(keys.command_used(self.robot), ())
        self._heard = {
            policy: np.array([name in contract.names for name in asked], dtype=np.bool_)
            for policy, part in self.listens.items()
            if (contract := self.contract(keys.command_used(f"{self.robot}_{part}"))) is not None
        }

    @property
    def context(self) -> set[str]:
        """Keys of which every step shall carry the newest value."""
        return {keys.command_source(self.robot)}

    def feed(self, step: Step) -> str:
        """Add a step, and return the state that the gate was in, "" where nothing says."""
        self._times.append(step.at_ns)
        self._numbers[step.source].append(step.number)
        self._held.setdefault(frozenset(step.values), [0, step.at_ns])[0] += 1
        gate = codec.parse_facts(step.values.get(keys.command_gate(self.robot)))
        self._gates.append(sys.intern(str(gate.get("state", ""))))
        self.heard = self._heard.get(str(gate.get("policy", "")))
        for name in ("clamped", "refused"):
            if isinstance(gate.get(name), int):
                self._counts[name] = max(self._counts.get(name, 0), gate[name])
        self._add_timing(step)
        self._add_pose(step)
        if self._gates[-1] == _TRACKING and self._is_playing(step):
            self._compare(step)
        return self._gates[-1]

    def result(self, paused: Sequence[Span] = ()) -> StepQuality:
        """Return the measures of all steps; announced pauses of the commands are left out."""
        tracking = self._tracking
        errors = tracking.joint_errors_rad if tracking else {}
        worst = max(errors, key=errors.__getitem__, default="")
        times, gates = np.array(self._times, dtype=np.int64), np.array(self._gates, dtype=np.str_)
        away = _paused(times, gates, [span for span in paused if any(key.endswith(self.robot) for key in span.keys)])
        timed = np.array(self._timed, dtype=np.int64)
        age, stages = _latencies(
            np.frombuffer(self._timings, np.int64).reshape(-1, _FIRST_STAGE + len(_STAGES)),
            _followed(gates[timed]) & ~away[timed],
        )
        shares, interrupted = _gate_shares(times, gates, away)
        return StepQuality(
            robot=self.robot,
            steps=len(self._times),
            missing_steps=sum(_missing(numbers) for numbers in self._numbers.values()),
            command_age=age,
            stages=stages,
            gate_shares=shares,
            interrupted_share=interrupted,
            clamped=self._counts.get("clamped"),
            refused=self._counts.get("refused"),
            lacking=self._lacking(),
            compared_steps=tracking.ticks if tracking else 0,
            mean_joint_error_rad=tracking.mean_joint_error_rad if tracking else None,
            worst_joint=worst,
            worst_joint_error_rad=errors.get(worst),
            joint_errors_rad=errors,
            mean_root_height_error_m=tracking.mean_root_height_error_m if tracking else None,
            velocity=self._velocity.found() if self._velocity else None,
        )

    def velocity_curves(self) -> Floats:
        """Return how velocities were followed, as `VelocityTracking.curves`, shape (n, 7); n is 0 where none were."""
        return np.empty((0, 7)) if self._velocity is None else self._velocity.curves()

    def _lacking(self) -> dict[str, Seen]:
        """Return in how many steps each key is missing that nearly all of them hold; their keys are written at once."""
        found = {}
        for key in (family(self.robot) for family in RESULTS):
            without = [counted for held, counted in self._held.items() if key not in held]
            count = sum(counted[0] for counted in without)
            if 0 < count < _MOST_LACKING * len(self._times):
                first_s = round((min(counted[1] for counted in without) - self.start_ns) * 1e-9, 3)
                found[key] = Seen(count, first_s)
        return found

    def falls(self) -> list[FallSeen]:
        """Return the falls that the recorded pose shows."""
        for key in (keys.sim_qpos(self.robot), keys.robot_state(self.robot)):  # ground truth where there is one
            if key in self._poses:
                values = np.frombuffer(self._poses[key], dtype="<f8").reshape(-1, 4)
                tilt = rotations.tilt(rotations.normalized(values))
                times_s = (np.array(self._pose_times[key]) - self.start_ns) * 1e-9
                return falls.from_pose(self.robot, times_s, tilt)
        return []

    def _add_timing(self, step: Step) -> None:
        if (numbers := timing_row(step.values.get(keys.policy_timing(self.robot)))) is not None:
            self._timings.extend(numbers)
            self._timed.append(len(self._gates) - 1)

    def _add_pose(self, step: Step) -> None:
        for key in (keys.sim_qpos(self.robot), keys.robot_state(self.robot)):
            data, names = step.values.get(key), self._layouts.get(key, ())
            if data and len(data) == 8 * len(names) and QUAT[0] in names:
                first = names.index(QUAT[0])
                if names[first : first + len(QUAT)] == QUAT:
                    self._poses[key] += data[8 * first : 8 * (first + len(QUAT))]  # an hour of it is 6 MB
                    self._pose_times[key].append(step.at_ns)

    def _is_playing(self, step: Step) -> bool:
        source = codec.parse_facts(step.before.get(keys.command_source(self.robot)))
        # A foreign writer states no phase; its commands are meant from the first to the last.
        return not source or source.get("phase", _PLAYING) == _PLAYING

    def _compare(self, step: Step) -> None:
        """Compare the command with the motion: the elements that the policy listens to."""
        used = self._named(step, keys.command_used(self.robot))
        state = self._named(step, keys.robot_state(self.robot)) or self._named(step, keys.state_joints(self.robot))
        if used is None or state is None:
            return
        (asked_names, asked), (names, measured) = used, state
        if self.heard is not None:
            asked = np.where(self.heard, asked, np.nan)
        if self._tracking is None:
            self._joints = tuple(name.removesuffix("_pos") for name in names if name.endswith("_pos"))
            self._tracking = TrackingError(asked_names, self._joints)
        truth = self._named(step, keys.sim_qpos(self.robot))
        height_m = None if truth is None or _HEIGHT not in truth[0] else float(truth[1][truth[0].index(_HEIGHT)])
        self._tracking.add(measured[: len(self._joints)], asked, height_m)
        if self._velocity is None and self.period_s is not None:
            self._velocity = VelocityTracking(asked_names, self.period_s)
        if self._velocity is not None and truth is not None and truth[0][: len(_PLACE)] == _PLACE:
            at_s = (step.at_ns - self.start_ns) * 1e-9
            self._velocity.add(step.number, at_s, asked, truth[1][:3], truth[1][3:7])

    def _named(self, step: Step, key: str) -> tuple[tuple[str, ...], Floats] | None:
        data, names = step.values.get(key), self._layouts.get(key)
        if data is None or names is None or len(data) != 8 * len(names):
            return None
        return names, codec.parse_f64(data)


def spread(values: NDArray[Any]) -> Spread:
    """Return median, 99th percentile and greatest of durations [ns] in seconds."""
    if not len(values):
        return Spread(0)
    seconds = values * 1e-9
    p50, p99 = np.percentile(seconds, (50, 99))
    return Spread(len(values), float(p50), float(p99), float(seconds.max()))


def _paused(times: NDArray[np.int64], gates: NDArray[np.str_], spans: Sequence[Span]) -> NDArray[np.bool_]:
    """Return which steps belong to a pause of the commands: until the robot tracks the next ones."""
    found = np.zeros(len(times), dtype=np.bool_)
    tracked = np.flatnonzero(gates == _TRACKING)
    for span in spans:
        again = tracked[times[tracked] > span.to_ns]
        found |= (times > span.from_ns) & (times < times[again[0]] if len(again) else True)
    return found


def _followed(gates: NDArray[np.str_]) -> NDArray[np.bool_]:
    """Return which steps lie between the first and the last that followed a command; a robot left alone uses none."""
    found = np.zeros(len(gates), dtype=np.bool_)
    used = np.flatnonzero(np.isin(gates, MOVING))
    if len(used):
        found[used[0] : used[-1] + 1] = True
    return found


def _latencies(timings: NDArray[np.int64], followed: NDArray[np.bool_]) -> tuple[Spread, dict[str, Spread]]:
    """Return the age of the command at use over the followed steps, and the time between stages over all."""
    instants = timings[:, _FIRST_STAGE:]
    pairs = [*pairwise(_STAGES), (_STAGES[0], _STAGES[-1])]
    stages = {}
    for start, end in pairs:
        a, b = instants[:, _STAGES.index(start)], instants[:, _STAGES.index(end)]
        known = (a > 0) & (b > 0)
        stages[f"{start}_to_{end}"] = spread((b - a)[known])
    written, arrived, used = (instants[:, _STAGES.index(s)] for s in ("command_written", "command_arrived", "observed"))
    since = np.where(written > 0, written, arrived)
    known = (since > 0) & (used > 0)
    return spread((used - since)[followed & known]), stages


def _gate_shares(
    times_ns: NDArray[np.int64], states: NDArray[np.str_], paused: NDArray[np.bool_]
) -> tuple[dict[str, float], float]:
    """Return the share of time in each state, and the share between first and last tracking that was not tracking."""
    if not len(states):
        return {}, 0.0
    lengths = np.diff(times_ns)
    lengths = np.append(lengths, np.median(lengths) if len(lengths) else 1)
    total = max(float(lengths.sum()), 1.0)
    shares = {str(state): float(lengths[states == state].sum()) / total for state in np.unique(states) if state}
    tracking = np.flatnonzero(states == _TRACKING)
    if not len(tracking):
        return shares, 0.0
    inside = np.zeros(len(states), dtype=np.bool_)
    inside[tracking[0] : tracking[-1] + 1] = True
    inside &= ~paused
    away = float(lengths[inside & (states != _TRACKING)].sum())
    return shares, away / max(float(lengths[inside].sum()), 1.0)


def _missing(numbers: array[int]) -> int:
    return max(numbers) - min(numbers) + 1 - len(set(numbers))
