"""A captured person as a motion file of the G1: the layers that retarget live, frame after frame, and what they did."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adapters.captures.captured import Captured
from adapters.captures.load import load
from adapters.motions import npz_file, raw
from adapters.motions.bad_frames import mend
from adapters.retarget.pipeline import BodyRetarget
from adapters.retarget.scaling import LOWEST_M
from adapters.retarget.skeleton_file import Skeletons
from adapters.retarget.smoothing import BodySmoother, Smoothness
from adapters.robots.g1 import joints as g1
from adapters.robots.g1 import kinematics
from adapters.robots.g1.joints import G1_29
from station import assets, rotations
from station.errors import BadFile
from station.protocols import FALL_TILT_RAD, Floats
from station.retargeting import Retargeted, RetargetTask

CLEAN = Smoothness(rest_hz=20.0, per_mps=40.0, per_rad_s=20.0)
"""Captures were filtered where they were made: 8 ms late at rest, 3 ms at 1 m/s."""

STEPS_HZ = 90.0
"""The layers run at least so often, as live: limits on speeds are per step."""

_AT_LIMIT_RAD = 1e-3
_AT_LOWEST_M = 0.02
_AT_SPEED = 0.999
_FORMAT = 1  # of the provenance; rises with what would be made of the same file


def retarget(task: RetargetTask) -> Retargeted:
    """Retarget a capture onto the G1 and write its motion file (`station.retargeting.Retargeter`).

    Raises:
        BadFile: the capture cannot be read, or another motion is at the target.
        StationError: a library is missing.
    """
    provenance = _provenance(task)
    if task.target.exists() and not task.force:
        if _provenance_of(task.target) != provenance:
            raise BadFile(f"{task.target}: is there, and not what would be made of {task.source}; --force replaces it")
        return Retargeted(source=str(task.source), target=str(task.target), is_kept=True)
    captured = load(task.source, units=task.units, height_m=task.height_m)
    run = _run(captured, task.fps)
    frames = run.qpos[:: run.every]
    why_not = _why_not(task, frames)
    if not why_not:
        task.target.parent.mkdir(parents=True, exist_ok=True)
        npz_file.save(task.target, fps=task.fps, root_pos=frames[:, :3], root_quat_wxyz=frames[:, 3:7],
                      joint_pos=frames[:, 7:], joint_names=G1_29, provenance=provenance)  # fmt: skip
    return Retargeted(
        source=str(task.source), target="" if why_not else str(task.target),
        seconds=round((len(frames) - 1) / task.fps, 3), fps=task.fps, frames=len(frames),
        captured_fps=round(captured.fps, 3), height_m=round(captured.calibration.height_m, 3), unit=captured.unit,
        at_limit_s=run.at_limit_s(), slowed_s=run.slowed_s(), slide_mps=round(run.slide_mps(), 4),
        notes=(*captured.notes, *run.notes), why_not=why_not,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """What the layers made of a person, step by step.

    Attributes:
        qpos: Root and joints, shape (n, 36).
        carries: Which feet were held on the floor, shape (n, 2).
        step_s: Time from step to step [s].
        every: Which steps are frames of the motion: every so many.
        speeds: Greatest speeds of root and joints, as `adapters.retarget.body_ik.BodyIK.speeds`, shape (35,).
        notes: What was done beside.
    """

    qpos: Floats
    carries: NDArray[np.bool_]
    step_s: float
    every: int
    speeds: Floats
    notes: tuple[str, ...]

    def at_limit_s(self) -> dict[str, float]:
        """Return for how long each joint was at an end of its range, those that were [s]."""
        q = self.qpos[:, 7:]
        is_there = (q <= g1.lower(G1_29) + _AT_LIMIT_RAD) | (q >= g1.upper(G1_29) - _AT_LIMIT_RAD)
        return self._times(G1_29, is_there)

    def slowed_s(self) -> dict[str, float]:
        """Return for how long each joint, and the root, was as fast as it may be, so that it lagged behind [s]."""
        turned = rotations.multiply(rotations.inverse(self.qpos[:-1, 3:7]), self.qpos[1:, 3:7])
        went = np.column_stack([
            np.diff(self.qpos[:, :3], axis=0), rotations.rotation_vector(turned), np.diff(self.qpos[:, 7:], axis=0),
        ])  # fmt: skip
        is_at = np.abs(went) >= self.speeds * self.step_s * _AT_SPEED
        return self._times((*G1_29, "root"), np.column_stack([is_at[:, 6:], is_at[:, :6].any(axis=1)]))

    def slide_mps(self) -> float:
        """Return the mean speed over the floor of the feet while they carry [m/s]; 0 where none ever does."""
        links = kinematics.forward(self.qpos[:, :3], self.qpos[:, 3:7], self.qpos[:, 7:])
        speeds = []
        for foot, side in enumerate(("left", "right")):
            sole = links.points(f"{side}_ankle_roll", kinematics.SOLE_POINTS).mean(axis=1)[:, :2]
            both = self.carries[1:, foot] & self.carries[:-1, foot]
            speeds.append(np.linalg.norm(np.diff(sole, axis=0), axis=1)[both] / self.step_s)
        slid = np.concatenate(speeds)
        return float(slid.mean()) if len(slid) else 0.0

    def _times(self, names: tuple[str, ...], is_so: NDArray[np.bool_]) -> dict[str, float]:
        counts = is_so.sum(axis=0)
        return {name: round(float(count) * self.step_s, 3) for name, count in zip(names, counts, strict=True) if count}


def _run(captured: Captured, fps: float) -> _Run:
    """Retarget a person; the layers run on even steps, of which every k-th is a frame of the motion."""
    every = max(1, math.ceil(STEPS_HZ / fps))
    step_s = 1.0 / (fps * every)
    person = resampled(captured.person, step_s)
    retargeting = BodyRetarget(captured.calibration, smoother=BodySmoother(CLEAN))
    qpos, carries = np.empty((len(person), 7 + len(G1_29))), np.empty((len(person), 2), dtype=np.bool_)
    for index in range(len(person)):
        reference = retargeting.step(person.body(index), person.capture_ns(index))
        qpos[index] = np.concatenate([reference.root_pos, reference.root_quat_wxyz, reference.q])
        carries[index] = retargeting.hold.carries
    notes = []
    if low := int((qpos[:, 2] < LOWEST_M + _AT_LOWEST_M).sum()):
        notes.append(f"the pelvis is asked no lower than {LOWEST_M:g} m, where it is for {low * step_s:.1f} s")
    if retargeting.anchor.jumps:
        notes.append(f"the capture leaps {retargeting.anchor.jumps} times; the robot stays where it is then")
    if rescues := sum(rescue.rescues for rescue in retargeting.ik.rescues):
        notes.append(f"an arm that was caught was led back {rescues} times")
    return _Run(qpos, carries, step_s, every, retargeting.ik.speeds, tuple(notes))


def resampled(person: Skeletons, step_s: float) -> Skeletons:
    """Return a motion at even times from its first frame on: places linear between frames, orientations by slerp."""
    begin = person.times_s[0]
    times = begin + np.arange(int((person.times_s[-1] - begin) / step_s + 1e-6) + 1) * step_s
    if len(times) < 2:
        raise BadFile(f"the capture lasts {person.times_s[-1] - begin:.3f} s; expected {step_s:.3f} s at least")
    lower = np.clip(np.searchsorted(person.times_s, times, side="right") - 1, 0, len(person) - 2)
    span = person.times_s[lower + 1] - person.times_s[lower]
    part = np.clip((times - person.times_s[lower]) / span, 0.0, 1.0)
    at, quats = person.positions, person.quats_wxyz
    return Skeletons(
        at[lower] + part[:, None, None] * (at[lower + 1] - at[lower]),
        rotations.slerp(quats[lower], quats[lower + 1], np.broadcast_to(part[:, None], quats[lower].shape[:2])),
        times,
        person.height_m,
    )


def _provenance(task: RetargetTask) -> dict[str, Any]:
    """Return what a motion file says of where it is from; the same for what would be made alike."""
    said = {
        "name": task.target.stem, "made_by": "station retarget", "made_as": _FORMAT, "source": task.source.name,
        "source_sha256": assets.sha256(task.source), "robot": task.robot, "fps": task.fps,
        "height_m": task.height_m, "units": task.units,
    }  # fmt: skip
    return {name: value for name, value in said.items() if value is not None}


def _provenance_of(path: Path) -> dict[str, Any]:
    """Return what a file says of where it is from; nothing of one that is no motion."""
    try:
        return dict(npz_file.load(path).provenance)
    except BadFile:
        return {}


def _why_not(task: RetargetTask, frames: Floats) -> str:
    """Return why the station would not play frames of shape (n, 36), or would take the robot for fallen; else ""."""
    tilt = rotations.tilt(frames[:, 3:7])
    if (tilt > FALL_TILT_RAD).any():
        worst = int(tilt.argmax())
        return (
            f"{task.source}: the pelvis leans by {math.degrees(tilt[worst]):.0f}° at {worst / task.fps:.2f} s; a robot "
            f"that leans by more than {math.degrees(FALL_TILT_RAD):.0f}° counts as fallen; cut the capture"
        )
    try:
        mend(raw.build(task.target, format="npz", fps=task.fps, root_pos=frames[:, :3],
                       root_quat_wxyz=frames[:, 3:7], q=frames[:, 7:]))  # fmt: skip
    except BadFile as error:
        return str(error)
    return ""
