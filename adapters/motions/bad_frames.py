"""Frames that cannot have happened: found by number and value, trimmed at the ends, refused or bridged inside.

Recordings of people carry them: a tracker that starts a metre too high for one frame, a solver whose first solution
lies far from its second, a hole while a marker was hidden. Played to a robot, each is a kick.

A frame is bad by itself (not finite, astronomic, or its quaternion is none) or by its neighbours (a step between two
frames that no pelvis or joint makes). Which side of such a step is wrong is told by the longest run of frames without
one: going outwards from it, a run is kept when it can be reached from the last frame kept.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from adapters.motions.raw import RawMotion
from adapters.robots.g1 import joints as g1
from adapters.robots.g1.joints import G1_29
from station import rotations
from station.errors import BadFile
from station.protocols import Floats

Holes = Literal["refuse", "bridge"]
_LARGEST = 1e4  # m, rad or 1: nothing that a person does
_RANGE_TOLERANCE = 1e-6  # rad; retargeting stops at a joint's limit to within rounding

_SHOWN = 20  # findings listed in a manifest; the number of all of them stands beside


@dataclass(frozen=True, slots=True)
class Limits:
    """What no human motion on a G1 exceeds between two frames.

    The six example motions of TWIST2 reach 1.8 m/s, 1.0 m/s, 6.2 rad/s and 14.3 rad/s in their good frames; three of
    them begin with bad ones, at up to 96 m/s, 31 m/s, 51 rad/s and 35 rad/s.

    Attributes:
        root_speed: Speed of the pelvis [m/s]; a sprint at the G1's size has 5.
        root_climb: Vertical speed of the pelvis [m/s]; landing from a metre's fall has 4.4.
        root_turn: Angular speed of the pelvis [rad/s]; a fast pirouette has 10.
        joint_speed: Speed of any joint [rad/s]; the motors end at 20 to 37.
        longest_bridge_s: Longest hole that may be bridged [s].
        longest_detached_s: Longest run of frames, good in itself but out of reach, that is trimmed at an end [s].
    """

    root_speed: float = 6.0
    root_climb: float = 4.5
    root_turn: float = 12.0
    joint_speed: float = 30.0
    longest_bridge_s: float = 1.0
    longest_detached_s: float = 0.5


_STEPS = (("root speed", "m/s"), ("root climb", "m/s"), ("root turn rate", "rad/s"), ("joint speed", "rad/s"))


def mend(motion: RawMotion, *, holes: Holes = "refuse", limits: Limits = Limits()) -> tuple[RawMotion, Report]:
    """Return a motion whose frames are all good, and what was done to it.

    Args:
        motion: What the file holds.
        holes: Whether bad frames between good ones are refused, or bridged (positions and joints linearly, rotations
            by slerp). Ends are trimmed either way.
        limits: What counts as bad.

    Raises:
        BadFile: no good frames, holes that may not or cannot be bridged, or two takes in one file.
    """
    valid, findings = _valid_frames(motion)
    if valid.sum() < 2:
        raise BadFile(f"{motion.path}: {valid.sum()} of {len(motion)} frames are usable ({_first(findings)})")
    steps, step_findings = _good_steps(motion, valid, limits)
    findings += step_findings
    kept = _kept_frames(motion, valid, steps, limits)
    first, last = int(np.flatnonzero(kept)[0]), int(np.flatnonzero(kept)[-1])
    _refuse_second_take(motion, valid, (first, last), findings, limits)
    gaps = tuple(_gaps(kept, first, last))
    _check_holes(motion, gaps, findings, holes, limits)
    mended = _cut(_bridge(motion, gaps), first, last)
    return mended, Report(len(motion), first, last, gaps, tuple(findings), _violations(mended, first))


def _valid_frames(motion: RawMotion) -> tuple[NDArray[np.bool_], list[Finding]]:
    """Return which frames are good by themselves."""
    findings = []
    tables = (
        ("root position", motion.root_pos),
        ("root rotation", motion.root_quat_wxyz),
        ("joint position", motion.q),
    )
    valid = np.ones(len(motion), dtype=np.bool_)
    for name, table in tables:
        sane = np.abs(table) <= _LARGEST  # false for NaN
        for frame in np.flatnonzero(~sane.all(axis=1)):
            column = int(np.flatnonzero(~sane[frame])[0])
            what = f"{name} of {G1_29[column]}" if table is motion.q else f"{name}[{column}]"
            findings.append(Finding(int(frame), what, float(table[frame, column]), _LARGEST))
            valid[frame] = False
    norms = np.full(len(motion), np.nan)
    norms[valid] = np.linalg.norm(motion.root_quat_wxyz[valid], axis=1)
    for frame in np.flatnonzero(valid & (np.abs(norms - 1.0) > 0.1)):
        findings.append(Finding(int(frame), "norm of the root quaternion", float(norms[frame]), 1.0))
        valid[frame] = False
    return valid, sorted(findings, key=lambda finding: finding.frame)


def _speeds(motion: RawMotion, start: NDArray[np.intp], end: NDArray[np.intp]) -> Floats:
    """Mean speeds between pairs of frames, shape (pairs, 4), in the order of `_STEPS`."""
    shift = motion.root_pos[end] - motion.root_pos[start]
    quat_start, quat_end = (rotations.normalized(motion.root_quat_wxyz[frames]) for frames in (start, end))
    turn = rotations.rotation_vector(rotations.multiply(rotations.inverse(quat_start), quat_end))
    bend = np.abs(motion.q[end] - motion.q[start]).max(axis=1)
    moved = np.stack([np.linalg.norm(shift, axis=1), np.abs(shift[:, 2]), np.linalg.norm(turn, axis=1), bend], axis=1)
    return np.asarray(moved * motion.fps / (end - start)[:, None])


def _greatest(limits: Limits) -> Floats:
    return np.array([limits.root_speed, limits.root_climb, limits.root_turn, limits.joint_speed])


def _good_steps(motion: RawMotion, valid: NDArray[np.bool_], limits: Limits) -> tuple[NDArray[np.bool_], list[Finding]]:
    """Return which steps from a frame to the next are possible, shape (n - 1,)."""
    steps = valid[:-1] & valid[1:]
    starts = np.flatnonzero(steps)
    if not len(starts):
        return steps, []
    speeds, greatest = _speeds(motion, starts, starts + 1), _greatest(limits)
    steps[starts] = (speeds <= greatest).all(axis=1)
    findings = []
    for row, kind in np.argwhere(speeds > greatest):
        frame, (what, unit) = int(starts[row]), _STEPS[kind]
        if what == "joint speed":
            what = f"speed of {G1_29[int(np.abs(motion.q[frame + 1] - motion.q[frame]).argmax())]}"
        findings.append(Finding(frame, what, float(speeds[row, kind]), float(greatest[kind]), unit, frame + 1))
    return steps, findings


def _runs(valid: NDArray[np.bool_], steps: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return runs of valid frames joined by good steps, as (first, last)."""
    runs: list[tuple[int, int]] = []
    for frame in np.flatnonzero(valid):
        if runs and runs[-1][1] == frame - 1 and steps[frame - 1]:
            runs[-1] = (runs[-1][0], int(frame))
        else:
            runs.append((int(frame), int(frame)))
    return runs


def _kept_frames(
    motion: RawMotion, valid: NDArray[np.bool_], steps: NDArray[np.bool_], limits: Limits
) -> NDArray[np.bool_]:
    runs = _runs(valid, steps)
    longest = max(range(len(runs)), key=lambda index: runs[index][1] - runs[index][0])
    kept = np.zeros(len(motion), dtype=np.bool_)
    kept[runs[longest][0] : runs[longest][1] + 1] = True

    def reachable(start: int, end: int) -> bool:
        speeds = _speeds(motion, np.array([start]), np.array([end]))[0]
        return bool((speeds <= _greatest(limits)).all())

    edge = runs[longest][1]
    for first, last in runs[longest + 1 :]:
        if reachable(edge, first):
            kept[first : last + 1], edge = True, last
    edge = runs[longest][0]
    for first, last in reversed(runs[:longest]):
        if reachable(last, edge):
            kept[first : last + 1], edge = True, first
    return kept


def _gaps(kept: NDArray[np.bool_], first: int, last: int) -> Iterator[tuple[int, int]]:
    for before, after in itertools.pairwise((np.flatnonzero(kept[first : last + 1]) + first).tolist()):
        if after > before + 1:
            yield before + 1, after - 1


def _refuse_second_take(
    motion: RawMotion, valid: NDArray[np.bool_], used: tuple[int, int], findings: list[Finding], limits: Limits
) -> None:
    """Refuse to call a long stretch of good frames an end to be trimmed: the file holds two takes, and whose?"""
    first, last = used
    for count, where in (
        (valid[:first].sum(), f"before frame {first}"),
        (valid[last + 1 :].sum(), f"after frame {last}"),
    ):
        if count > limits.longest_detached_s * motion.fps:
            raise BadFile(
                f"{motion.path}: {count} good frames {where} cannot be reached from the others "
                f"({_first(findings)}); cut the file in two"
            )


def _check_holes(
    motion: RawMotion, gaps: tuple[tuple[int, int], ...], findings: list[Finding], holes: Holes, limits: Limits
) -> None:
    if not gaps:
        return
    listed = ", ".join(f"{first}-{last}" if last > first else f"{first}" for first, last in gaps[:5])
    more = ", …" if len(gaps) > 5 else ""
    inside = [finding for finding in findings if finding.frame >= gaps[0][0] - 1]
    if holes == "refuse":
        raise BadFile(
            f"{motion.path}: bad frames {listed}{more} between good ones ({_first(inside)}); "
            "mend the file, or set holes to bridge"
        )
    for first, last in gaps:
        if last - first + 2 > limits.longest_bridge_s * motion.fps:
            raise BadFile(
                f"{motion.path}: bad frames {first}-{last} ({_first(inside)}) last longer than the "
                f"{limits.longest_bridge_s:g} s that may be bridged; cut the file in two"
            )


def _bridge(motion: RawMotion, gaps: tuple[tuple[int, int], ...]) -> RawMotion:
    position, quats, q = motion.root_pos.copy(), motion.root_quat_wxyz.copy(), motion.q.copy()
    for first, last in gaps:
        before, after = first - 1, last + 1
        part = np.arange(1, after - before) / (after - before)
        for table in (position, q):
            table[first:after] = table[before] + part[:, None] * (table[after] - table[before])
        ends = rotations.normalized(quats[[before, after]])
        quats[first:after] = rotations.slerp(ends[0], ends[1], part)
    return replace(motion, root_pos=position, root_quat_wxyz=quats, q=q)


def _cut(motion: RawMotion, first: int, last: int) -> RawMotion:
    used = slice(first, last + 1)
    quats = rotations.normalized(motion.root_quat_wxyz[used])
    return replace(motion, root_pos=motion.root_pos[used], root_quat_wxyz=quats, q=motion.q[used])


def _violations(motion: RawMotion, first: int) -> tuple[RangeViolation, ...]:
    beyond = np.maximum(g1.lower(G1_29) - motion.q, motion.q - g1.upper(G1_29))
    found = []
    for column in np.flatnonzero((beyond > _RANGE_TOLERANCE).any(axis=0)):
        worst = int(beyond[:, column].argmax())
        count = int((beyond[:, column] > _RANGE_TOLERANCE).sum())
        found.append(RangeViolation(G1_29[column], count, float(beyond[worst, column]), first + worst))
    return tuple(found)


def _first(findings: list[Finding]) -> str:
    return str(findings[0]) if findings else "no cause found"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing wrong with one frame, or with the step from it to `to_frame`."""

    frame: int
    what: str
    value: float
    limit: float
    unit: str = ""
    to_frame: int | None = None

    def __str__(self) -> str:
        where = f"frame {self.frame}" if self.to_frame is None else f"frames {self.frame}->{self.to_frame}"
        return f"{where}: {self.what} {self.value:.4g} {self.unit}".rstrip() + f" (limit {self.limit:.4g})"


@dataclass(frozen=True, slots=True)
class RangeViolation:
    """A joint beyond its range: reported, and clamped at the gate, but no reason to refuse a motion."""

    joint: str
    frames: int
    worst_rad: float
    at_frame: int

    def __str__(self) -> str:
        worst = f"at frame {self.at_frame} by {self.worst_rad:.3f} rad"
        return f"{self.joint} is beyond its range in {self.frames} frames, {worst}"


@dataclass(frozen=True, slots=True)
class Report:
    """What was found in a file and what was done; frames are numbered from 0 as in the file.

    Attributes:
        frames: Frames in the file.
        first, last: The frames that are used, both included.
        bridged: Holes inside, as (first, last) bad frame, that were filled by interpolation.
        findings: Every bad frame and step.
        violations: Joints beyond their range in the frames that are used.
    """

    frames: int
    first: int
    last: int
    bridged: tuple[tuple[int, int], ...]
    findings: tuple[Finding, ...]
    violations: tuple[RangeViolation, ...]

    @property
    def trimmed(self) -> tuple[int, int]:
        """Number of frames cut off at the start and at the end."""
        return self.first, self.frames - 1 - self.last

    def lines(self) -> list[str]:
        """Return the report for people; empty when there is nothing to say."""
        lines = [str(finding) for finding in self.findings[:_SHOWN]]
        if len(self.findings) > _SHOWN:
            lines.append(f"… and {len(self.findings) - _SHOWN} more")
        if any(self.trimmed):
            lines.append(f"trimmed: {self.trimmed[0]} frames at the start, {self.trimmed[1]} at the end")
        lines += [f"bridged: frames {first} to {last}" for first, last in self.bridged]
        return lines + [str(violation) for violation in self.violations]

    def facts(self) -> dict[str, Any]:
        """Return the report for a manifest."""
        return {
            "frames_in_file": self.frames,
            "first_frame": self.first,
            "last_frame": self.last,
            "trimmed": {"start": self.trimmed[0], "end": self.trimmed[1]},
            "bridged": [list(hole) for hole in self.bridged],
            "bad_frames": [str(finding) for finding in self.findings[:_SHOWN]],
            "bad_frames_found": len(self.findings),
            "beyond_range": [str(violation) for violation in self.violations],
        }
