"""The rules about cameras, motion, arms, and commands beside states; `station.episode.quality.rules` has the others."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from station.bus import keys
from station.episode.quality.cameras import told_apart
from station.episode.quality.finding_parts import PictureQuality, Seen
from station.episode.quality.findings import Quality, Verdict
from station.episode.quality.rule_file import Limits

Finder = Callable[[Quality, Limits], Iterator[tuple[Verdict, str]]]
"""Finds what a rule speaks of: verdict by its limits, and the fact in a sentence."""

GAP_PERIODS = 3  # a camera that is set to few pictures a second gives none for long
_ANY_HZ = 1e9


def _camera_drops(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for camera in told_apart(quality.cameras):
        if camera.drop_share > limits.camera_drops.usable_above_share:
            verdict: Verdict = "reject" if camera.drop_share > limits.camera_drops.reject_above_share else "usable"
            text = f"camera {camera.name}: {camera.missing} of {camera.expected} pictures are missing"
            yield verdict, f"{text}, {camera.lost} of them by number"


def _camera_gap(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for camera in told_apart(quality.cameras):
        gap_s = camera.longest_gap_s or 0.0
        if gap_s > max(limits.camera_gap.usable_above_s, GAP_PERIODS / (camera.nominal_hz or _ANY_HZ)):
            verdict: Verdict = "reject" if gap_s > limits.camera_gap.reject_above_s else "usable"
            yield verdict, f"camera {camera.name}: no picture for {gap_s:.2f} s from {camera.gap_at_s or 0.0:.2f} s on"


def _camera_slow(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for camera in told_apart(quality.cameras):
        if camera.rate_hz is None or camera.nominal_hz is None:
            continue
        if camera.rate_hz < limits.camera_slow.below_share * camera.nominal_hz:
            yield "usable", f"camera {camera.name}: {camera.rate_hz:.1f} Hz, nominal {camera.nominal_hz:g} Hz"


def _misaligned(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    least_s, most_s = limits.misaligned.lag_below_s, limits.misaligned.lag_above_s
    for found in quality.alignment:
        if found.lag_s is None or least_s <= found.lag_s <= most_s:
            continue
        how = "after" if found.lag_s > 0 else "before"
        text = f"joints move {abs(found.lag_s) * 1e3:.0f} ms {how} the command that they got"
        yield "usable", f"{found.robot}: {text}, by {keys.command_used(found.robot)} and {found.state_key}"


def _idle_ends(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.motion:
        for where, idle_s in (("the first", robot.idle_head_s), ("the last", robot.idle_tail_s)):
            if idle_s > limits.idle_ends.above_s and not robot.is_carried:
                yield "usable", f"{robot.robot}: nothing moves in {where} {idle_s:.1f} s"


def _jerky(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.motion:
        jerk = robot.jerk_p99_rad_s3
        if jerk is not None and jerk > limits.jerky.p99_above_rad_s3:
            worst = f"most {robot.worst_jerk_joint} with {robot.jerk_max_rad_s3 or 0.0:.0f}"
            yield "usable", f"{robot.robot}: jerk {jerk:.0f} rad/s\u00b3 (p99), {worst}"


def _jerky_command(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.motion:
        jerk = robot.command_jerk_p99_rad_s3
        if jerk is not None and jerk > limits.jerky_command.p99_above_rad_s3:
            worst = f"most {robot.command_worst_jerk_joint}"
            yield "usable", f"{robot.robot}: jerk of the command {jerk:.0f} rad/s\u00b3 (p99), {worst}"


def _joint_limits(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.motion:
        if robot.limit_share > limits.joint_limits.above_share and not robot.is_carried:
            joint = next(iter(robot.limit_joints))
            yield "usable", f"{robot.robot}: {joint} at its end for {robot.limit_share:.0%} of the time"


def _arm_fault(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for arm in quality.arms:
        if arm.faults:
            yield "reject", f"{arm.robot}: {arm.faults} fault(s) of its controller"


def _arm_sync(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for arm in quality.arms:
        target = keys.target(arm.robot)  # one per heartbeat
        nominal_hz = next((one.nominal_hz for one in quality.streams if one.key == target and one.nominal_hz), 0.0)
        if arm.sync_hz is not None and arm.sync_hz < limits.arm_sync.below_share * nominal_hz:
            yield "usable", f"{arm.robot}: {arm.sync_hz:.1f} heartbeats a second were heard, {nominal_hz:g} expected"


def _arm_flood(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for arm in quality.arms:
        if (arm.sends_holding_hz or 0.0) > limits.arm_flood.above_hz:
            yield "usable", f"{arm.robot}: {arm.sends_holding_hz:.1f} targets a second were sent at hold, 0 expected"


def _camera_torn(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for found in quality.pictures:
        told = []
        if found.torn.count:
            form = "JPEG" if found.depth is None else "PNG"
            told.append(f"{_of(found.torn, found.pictures)} are no whole {form} file")
        if found.unreadable.count:
            told.append(f"{_of(found.unreadable, found.looked_at)} looked at cannot be decoded")
        if told:
            # Of those that are whole by their ends a few are tried: one of them alone says nothing of a share.
            tried = found.unreadable.count / found.looked_at if found.unreadable.count > 1 else 0.0
            share = max((found.torn.count + found.unreadable.count) / found.pictures, tried)
            verdict: Verdict = "reject" if share > limits.camera_torn.reject_above_share else "usable"
            yield verdict, f"{_camera(found)}: {'; '.join(told)}"


def _camera_resized(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for found in quality.pictures:
        if found.resized.count:
            sizes = f"{found.sizes[0]} px at first, then {', '.join(found.sizes[1:])}"
            yield "reject", f"{_camera(found)}: {sizes}: {_of(found.resized, found.pictures)} differ from the first"


def _camera_frozen(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    nominal_hz = {camera.key: camera.nominal_hz for camera in quality.cameras}
    for found in quality.pictures:
        least_s = max(limits.camera_frozen.usable_above_s, GAP_PERIODS / (nominal_hz.get(found.key) or _ANY_HZ))
        if found.frozen_s > least_s and found.frozen_at_s is not None:
            verdict: Verdict = "reject" if found.frozen_s > limits.camera_frozen.reject_above_s else "usable"
            text = f"the same picture from {found.frozen_at_s:.2f} s on, while joints moved for {found.frozen_s:.1f} s"
            yield verdict, f"{_camera(found)}: {text}"


def _camera_repeats(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for found in quality.pictures:
        if found.repeats_moving.count > limits.camera_repeats.above_share * found.moving:
            what = f"{_of(found.repeats_moving, found.moving)} taken while joints moved are the one before once more"
            yield "usable", f"{_camera(found)}: {what}"


def _camera_black(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for found in quality.pictures:
        if found.black.count > limits.camera_black.usable_above_share * found.looked_at:
            is_most = found.black.count > limits.camera_black.reject_above_share * found.looked_at
            verdict: Verdict = "reject" if is_most else "usable"
            yield verdict, f"{_camera(found)}: {_of(found.black, found.looked_at)} looked at are black"


def _camera_blurred(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for found in quality.pictures:
        if found.focus_lost_s is not None:
            yield "usable", f"{_camera(found)}: its focus went at {found.focus_lost_s:.2f} s"
        elif found.relative_sharpness is not None and found.relative_sharpness < limits.camera_blurred.below:
            text = f"sharpness {found.relative_sharpness:.3f}, expected {limits.camera_blurred.below:g} and more"
            yield "usable", f"{_camera(found)}: {text}"


def _camera_turned(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for found in quality.pictures:
        if found.turned.count:
            yield "usable", f"{_camera(found)}: turned upside down at {found.turned.first_s or 0.0:.2f} s"


def _camera_blind(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for found in quality.pictures:
        if found.depth is not None and found.depth.blind_s > limits.camera_blind.usable_above_s:
            verdict: Verdict = "reject" if found.depth.blind_s > limits.camera_blind.reject_above_s else "usable"
            text = f"sees nothing for {found.depth.blind_s:.1f} s from {found.depth.blind_at_s or 0.0:.2f} s on"
            yield verdict, f"{_camera(found)}: {text}, no pixel has a depth"


def _cameras_swapped(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for found_pictures in quality.pictures:
        if other := found_pictures.exchanged_with:
            where = f"at {found_pictures.exchanged_s:.2f} s"
            yield "reject", f"{_camera(found_pictures)}: shows from then on, {where}, what {other} showed before"
    if found := quality.swapped_cameras:
        how = "serial numbers" if found[0].told_by == "serial" else "what they see"
        what = ", ".join(f"{one.camera} is the one that was {one.was}" for one in found)
        yield "usable", f"cameras changed places since {found[0].episode_id}, by {how}: {what}"


def _too_many(
    seen: Callable[[PictureQuality], Seen], share: Callable[[Limits], float], words: str, verdict: Verdict = "usable"
) -> Finder:
    """Return a rule on cameras of which more than a share of the pictures looked at is seen to be something."""

    def find(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
        for found in quality.pictures:
            if seen(found).count > share(limits) * found.looked_at:
                yield verdict, f"{_camera(found)}: {_of(seen(found), found.looked_at)} looked at {words}"

    return find


def _camera(found: PictureQuality) -> str:
    return f"camera {found.name} ({found.key})"


def _of(seen: Seen, total: int) -> str:
    return f"{seen.count} of {total} pictures (the first at {seen.first_s or 0.0:.2f} s)"


SENSED: dict[str, Finder] = {
    "camera-drops": _camera_drops,
    "camera-gap": _camera_gap,
    "camera-slow": _camera_slow,
    "camera-torn": _camera_torn,
    "camera-resized": _camera_resized,
    "camera-frozen": _camera_frozen,
    "camera-repeats": _camera_repeats,
    "camera-black": _camera_black,
    "camera-saturated": _too_many(
        lambda one: one.white, lambda limits: limits.camera_saturated.above_share, "are blown out"
    ),
    "camera-flat": _too_many(lambda one: one.flat, lambda limits: limits.camera_flat.above_share, "show one colour"),
    "camera-exposure": _too_many(
        lambda one: one.exposure_jumps,
        lambda limits: limits.camera_exposure.above_share,
        "are the one before in another brightness",
    ),
    "camera-blurred": _camera_blurred,
    "camera-noise": _too_many(
        lambda one: one.noise, lambda limits: limits.camera_noise.above_share, "are noise", "reject"
    ),
    "camera-cut": _too_many(
        lambda one: one.cut,
        lambda limits: limits.camera_cut.above_share,
        "have a lower end of one colour, and the first ones none",
    ),
    "camera-turned": _camera_turned,
    "camera-blind": _camera_blind,
    "cameras-swapped": _cameras_swapped,
    "misaligned": _misaligned,
    "idle-ends": _idle_ends,
    "jerky": _jerky,
    "jerky-command": _jerky_command,
    "joint-limits": _joint_limits,
    "arm-fault": _arm_fault,
    "arm-sync": _arm_sync,
    "arm-flood": _arm_flood,
}
"""Those rules by the name that a reason carries."""
