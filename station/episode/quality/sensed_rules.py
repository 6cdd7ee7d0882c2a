"""The rules about cameras, motion, and a command beside its state; `station.episode.quality.rules` has the others."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from station.episode.quality.findings import Quality, Verdict
from station.episode.quality.rule_file import Limits

Finder = Callable[[Quality, Limits], Iterator[tuple[Verdict, str]]]
"""Finds what a rule speaks of: verdict by its limits, and the fact in a sentence."""


def _camera_drops(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for camera in quality.cameras:
        if camera.drop_share > limits.camera_drops.usable_above_share:
            verdict: Verdict = "reject" if camera.drop_share > limits.camera_drops.reject_above_share else "usable"
            text = f"camera {camera.name}: {camera.missing} of {camera.expected} pictures are missing"
            yield verdict, f"{text}, {camera.lost} of them by number"


def _camera_gap(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for camera in quality.cameras:
        gap_s = camera.longest_gap_s or 0.0
        if gap_s > limits.camera_gap.usable_above_s:
            verdict: Verdict = "reject" if gap_s > limits.camera_gap.reject_above_s else "usable"
            yield verdict, f"camera {camera.name}: no picture for {gap_s:.2f} s"


def _camera_slow(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for camera in quality.cameras:
        if camera.rate_hz is None or camera.nominal_hz is None:
            continue
        if camera.rate_hz < limits.camera_slow.below_share * camera.nominal_hz:
            yield "usable", f"camera {camera.name}: {camera.rate_hz:.1f} Hz, nominal {camera.nominal_hz:g} Hz"


def _misaligned(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    least_s, most_s = limits.misaligned.lag_below_s, limits.misaligned.lag_above_s
    for found in quality.alignment:
        if quality.lock_step or found.lag_s is None or least_s <= found.lag_s <= most_s:
            continue
        how = "after" if found.lag_s > 0 else "before"
        yield "usable", f"{found.robot}: joints move {abs(found.lag_s) * 1e3:.0f} ms {how} the command that they got"


def _idle_ends(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.motion:
        for where, idle_s in (("the first", robot.idle_head_s), ("the last", robot.idle_tail_s)):
            if idle_s > limits.idle_ends.above_s:
                yield "usable", f"{robot.robot}: nothing moves in {where} {idle_s:.1f} s"


def _jerky(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.motion:
        jerk = robot.jerk_p99_rad_s3
        if not quality.lock_step and jerk is not None and jerk > limits.jerky.p99_above_rad_s3:
            worst = f"most {robot.worst_jerk_joint} with {robot.jerk_max_rad_s3 or 0.0:.0f}"
            yield "usable", f"{robot.robot}: jerk {jerk:.0f} rad/s\u00b3 (p99), {worst}"


def _joint_limits(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.motion:
        if robot.limit_share > limits.joint_limits.above_share:
            joint = next(iter(robot.limit_joints))
            yield "usable", f"{robot.robot}: {joint} at its end for {robot.limit_share:.0%} of the time"


SENSED: dict[str, Finder] = {
    "camera-drops": _camera_drops,
    "camera-gap": _camera_gap,
    "camera-slow": _camera_slow,
    "misaligned": _misaligned,
    "idle-ends": _idle_ends,
    "jerky": _jerky,
    "joint-limits": _joint_limits,
}
"""Those rules by the name that a reason carries."""
