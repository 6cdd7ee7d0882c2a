"""``python -m adapters.retarget.evaluate [CLIP…]``: how well retargeting gives back the motion that a person imitates.

Each clip of the G1 is done by people of several heights (`skeleton`), measured in a T-pose (`calibration`), tracked at
90 Hz and retargeted frame by frame. Errors are against the clip at the instant of the frame, so what layers are late by
counts. Noise is white: worse than a tracker's, which drifts instead.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields

import numpy as np
from rich.console import Console
from rich.table import Table

from adapters.motions import builtin
from adapters.motions.load import load
from adapters.retarget.calibration import of_person
from adapters.retarget.human import G1_SIZED, of_height
from adapters.retarget.pipeline import BodyRetarget
from adapters.retarget.played import noisy, person_of
from adapters.robots.g1 import kinematics
from station.errors import StationError
from station.protocols import Floats, Motion, Reference

HEIGHTS_M = (None, 1.5, 1.7, 1.9)
"""None is a person of the robot's own size and shape."""

_SETTLED_S = 0.2
_HEAD = np.array([[0.0, 0.0, 0.4]])  # in the frame of torso_link
_STANDS_MPS = 0.02
_LEGS, _ARMS = slice(0, 12), slice(15, 29)


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """How near a retargeted motion comes to its clip.

    Attributes:
        legs_rad, arms_rad: Mean joint error [rad].
        worst_rad: Greatest error of any joint [rad].
        wrist_m, ankle_m, head_m: Mean error of places, seen from the pelvis [m].
        height_m: Mean error of the root's height [m].
        velocity_mps: Root mean square error of the root's velocity over the floor [m/s].
        yaw_rad_s: The same of its yaw rate [rad/s].
        slide_mps: Mean speed of the robot's feet while the clip's stand still [m/s].
        cpu_ms, cpu_p99_ms: Time of this thread per frame, all layers [ms].
    """

    legs_rad: float
    arms_rad: float
    worst_rad: float
    wrist_m: float
    ankle_m: float
    head_m: float
    height_m: float
    velocity_mps: float
    yaw_rad_s: float
    slide_mps: float
    cpu_ms: float
    cpu_p99_ms: float


def evaluate(motion: Motion, height_m: float | None, *, metres: float = 0.0, radians: float = 0.0) -> Score:
    """Let a person of a height do a clip, retarget it, and compare.

    Args:
        motion: Of the G1.
        height_m: How tall the person is [m]; None for one of the robot's size.
        metres, radians: Noise of the tracking.
    """
    lengths = G1_SIZED if height_m is None else of_height(height_m)
    person = person_of(motion, height_m)
    if metres or radians:
        person = noisy(person, metres=metres, radians=radians)
    retarget = BodyRetarget(of_person(lengths))
    came, taken_ms = [], []
    for index in range(len(person)):
        body, capture_ns = person.body(index), person.capture_ns(index)
        began_s = time.thread_time()
        came.append(retarget.step(body, capture_ns))
        taken_ms.append((time.thread_time() - began_s) * 1e3)
    wanted = [motion.at(time_s) for time_s in person.times_s.tolist()]
    return _scored(came, wanted, person.times_s, taken_ms)


def _scored(came: list[Reference], wanted: list[Reference], times_s: Floats, taken_ms: list[float]) -> Score:
    settled = int(np.searchsorted(times_s, _SETTLED_S))
    off = np.abs(_joints(came) - _joints(wanted))
    velocity = (_velocities(came) - _velocities(wanted))[settled:]
    ours, theirs = _links(came), _links(wanted)

    def apart(link: str, points: Floats) -> float:
        return float(np.linalg.norm(_seen(ours, link, points) - _seen(theirs, link, points), axis=-1).mean())

    origin = np.zeros((1, 3))
    return Score(
        legs_rad=float(off[:, _LEGS].mean()),
        arms_rad=float(off[:, _ARMS].mean()),
        worst_rad=float(off.max()),
        wrist_m=float(np.mean([apart(f"{side}_wrist_yaw", origin) for side in ("left", "right")])),
        ankle_m=float(np.mean([apart(f"{side}_ankle_roll", origin) for side in ("left", "right")])),
        head_m=apart("torso", _HEAD),
        height_m=float(np.abs(ours.position[0, :, 2] - theirs.position[0, :, 2]).mean()),
        velocity_mps=float(np.sqrt((velocity[:, :2] ** 2).sum(axis=1).mean())),
        yaw_rad_s=float(np.sqrt((velocity[:, 2] ** 2).mean())),
        slide_mps=_slide(ours, theirs, times_s),
        cpu_ms=float(np.percentile(taken_ms[1:], 50)),
        cpu_p99_ms=float(np.percentile(taken_ms[1:], 99)),
    )


def _joints(references: list[Reference]) -> Floats:
    return np.array([reference.q for reference in references])


def _velocities(references: list[Reference]) -> Floats:
    return np.array([[*reference.root_lin_vel[:2], reference.root_ang_vel[2]] for reference in references])


def _links(references: list[Reference]) -> kinematics.LinkPoses:
    return kinematics.forward(
        np.array([reference.root_pos for reference in references]),
        np.array([reference.root_quat_wxyz for reference in references]),
        _joints(references),
    )


def _seen(links: kinematics.LinkPoses, link: str, points: Floats) -> Floats:
    """Places of points of a link in the frame of the pelvis, shape (n, 3)."""
    away = links.points(link, points)[:, 0] - links.position[0]
    return np.asarray((links.rotation[0].swapaxes(-1, -2) @ away[..., None])[..., 0])


def _slide(ours: kinematics.LinkPoses, theirs: kinematics.LinkPoses, times_s: Floats) -> float:
    speeds = []
    for side in ("left", "right"):
        index = kinematics.INDEX[f"{side}_ankle_roll"]
        ran, stood = (
            np.linalg.norm(np.diff(links.position[index], axis=0)[:, :2], axis=1) / np.diff(times_s)
            for links in (ours, theirs)
        )
        speeds.append(ran[stood < _STANDS_MPS])
    slid = np.concatenate(speeds)
    return float(slid.mean()) if len(slid) else 0.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 0."""
    parser = argparse.ArgumentParser(prog="python -m adapters.retarget.evaluate", description=__doc__)
    parser.add_argument("clips", nargs="*", help="built-in clips or motion files; every built-in one but the tour")
    parser.add_argument("--height", type=float, action="append", help="of the person [m]; may be repeated")
    parser.add_argument("--noise-mm", type=float, default=0.0, help="of positions, standard deviation [mm]")
    parser.add_argument("--noise-deg", type=float, default=0.0, help="of orientations, standard deviation [deg]")
    options = parser.parse_args(arguments)
    clips = options.clips or [f"{builtin.clips.PREFIX}{name}" for name in builtin.names() if name != "tour"]
    table = Table(title="Retargeting: what comes back of a clip")
    for title in ("clip", "person", *(field.name for field in fields(Score))):
        table.add_column(title, justify="left" if title == "clip" else "right")
    try:
        for clip in clips:
            motion = load(clip)
            for height_m in options.height or HEIGHTS_M:
                noise = {"metres": options.noise_mm / 1e3, "radians": np.radians(options.noise_deg)}
                score = evaluate(motion, height_m, **noise)
                who = "G1" if height_m is None else f"{height_m:.2f} m"
                table.add_row(motion.name, who, *(f"{value:.3f}" for value in astuple(score)))
    except StationError as error:
        sys.stderr.write(f"{error}\n")
        return error.exit_code
    Console(width=None if sys.stdout.isatty() else 180).print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
