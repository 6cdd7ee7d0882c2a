"""What a check found, for a person."""

from __future__ import annotations

from rich.console import Console

from station.bus import keys
from station.cli.tables import Column, plain, print_table
from station.episode.quality import timing
from station.episode.quality.finding_parts import (
    Alignment,
    ArmQuality,
    CameraQuality,
    MotionQuality,
    PictureQuality,
    Plausibility,
)
from station.episode.quality.findings import Interruption, Quality, Spread, StepQuality, StreamQuality
from station.episode.storage.manifest import words_of_shortened
from station.episode.storage.manifest_parts import AuditFound

_MOST_ROWS = 20
_KINDS = {
    "bus-silent": ("silent once", "silent {} times"),
    "bus-lost": ("lost once", "lost {} times"),
    "bus-refused": ("refused writes once", "refused writes {} times"),
    "bulk-cut": ("the bulk bus cut once,", "the bulk bus cut {} times"),
    "watch-cut": ("unheard by a server once", "unheard by servers {} times"),
    "tap-cut": ("recording link cut once and resumed,", "recording link cut {} times and resumed"),
    "hole": ("1 hole in the recording,", "{} holes in the recording"),
    "recorder-restart": ("recorder restarted once, away", "recorder restarted {} times"),
}
_WHOLE_WAY = "command_written_to_sent"
_COLOURS = {"good": "green", "usable": "yellow", "reject": "red"}


def print_quality(quality: Quality, *, is_whole: bool = False) -> None:
    """Print verdict, reasons and what the robots did; then all streams, or those without the station's own."""
    console = Console(highlight=False)
    _print_verdict(console, quality)
    _print_interruptions(console, quality)
    told = [item.robot for item in quality.steps] + [item.robot for item in quality.motion]
    for robot in dict.fromkeys([*told, *(item.robot for item in quality.arms)]):
        console.print()
        _print_robot(console, quality, robot)
    console.print()
    _print_streams(console, quality.streams, is_whole=is_whole)
    _print_cameras(console, quality.cameras)
    _print_pictures(console, quality.pictures)
    if len(quality.rules) > 1:
        last = quality.rules[-1]
        console.print(
            f"\n[dim]judged by the rules of {plain(last.file)} (sha256 {last.sha256[:12]}…)[/]", soft_wrap=True
        )


def print_in_short(quality: Quality) -> None:
    """Print verdict and reasons, and of each robot how near it came to its command and how late it was."""
    console = Console(highlight=False)
    _print_verdict(console, quality)
    for steps in quality.steps:
        if text := _error(steps):
            console.print(f"  {text}", soft_wrap=True)
        if steps.velocity is not None:
            console.print(f"  {steps.velocity.in_short}", soft_wrap=True)
        if not quality.lock_step and (late := steps.stages.get(_WHOLE_WAY)) is not None:
            p50, p99 = _unit(late.p50_s, 1e3, "ms"), _unit(late.p99_s, 1e3, "ms")
            console.print(f"  command to joints {p50} (p50), {p99} (p99)", soft_wrap=True)


def _print_verdict(console: Console, quality: Quality) -> None:
    colour = _COLOURS[quality.verdict]
    console.print(
        f"[bold]{plain(quality.episode_id)}[/]: [{colour}]{quality.verdict}[/]   {_headline(quality)}", soft_wrap=True
    )
    for reason in quality.reasons:
        console.print(
            f"  [{_COLOURS[reason.verdict]}]{reason.verdict}[/] {reason.rule}: {plain(reason.text)}", soft_wrap=True
        )
    for line in timing.told(quality.not_judged):
        console.print(f"  [dim]not judged: {plain(line)}[/]", soft_wrap=True)
    if quality.audit is not None:
        console.print(f"  [dim]{plain(_audit_line(quality.audit))}[/]", soft_wrap=True)
        for line in quality.audit.not_audited:
            console.print(f"  [dim]not audited: {plain(line)}[/]", soft_wrap=True)
    if quality.shortened:
        console.print(f"  [dim]{plain(words_of_shortened(quality.shortened))}[/]", soft_wrap=True)


def _audit_line(found: AuditFound) -> str:
    """Return in a line what an audit found, and how much it could not."""
    if not found.compared:
        return "audit: nothing was compared"
    told = f"audit: {found.compared} vectors computed again, {found.different} different"
    return told if not found.not_proven else f"{told}; not proven in {found.not_proven} steps, see `station audit`"


def _headline(quality: Quality) -> str:
    lost = sum(stream.lost for stream in quality.streams)
    dropped = f", {quality.dropped} dropped" if quality.dropped else ""
    tap = f"{plain(quality.backend or 'unknown')} tap{'' if quality.is_lossless else ' (lossy)'}"
    if quality.times_of != "writers":
        tap = f"imported: {plain(quality.backend)}"
    return (
        f"{quality.length_s:.1f} s, {quality.messages} messages, {lost} lost{dropped}, {quality.falls} falls, "
        f"{quality.resets} resets, {quality.recorder_restarts} recorder restarts, {tap}"
    )


def _print_interruptions(console: Console, quality: Quality) -> None:
    """Print what became of the bus and of the recorder's link to it, a line each."""
    found = quality.interruptions
    if not found:
        console.print("\n[dim]bus: no interruption[/]")
        return
    console.print(f"\n[bold]bus[/]: {_summary(found)}", soft_wrap=True)
    columns = [*map(Column, ("at", "lasted", "lost")), Column("what", "left"), Column("told by", "left")]
    rows = [
        (
            f"{item.at_s:.2f} s",
            "to the end" if item.seconds is None else f"{item.seconds:.2f} s",
            "–" if item.lost is None else f"[red]{item.lost}[/]" if item.lost else "0",
            plain(f"{item.kind}: {item.reason}" if item.reason else item.kind),
            plain(", ".join(item.told_by)),
        )
        for item in found[:_MOST_ROWS]
    ]
    print_table(columns, rows, indent=2)
    if len(found) > _MOST_ROWS:
        console.print(f"  [dim]… and {len(found) - _MOST_ROWS} more; --json has all[/]")


def _summary(found: list[Interruption]) -> str:
    """Return in a line what the interruptions were, and what they cost."""
    words = []
    for kind, (one, several) in _KINDS.items():
        items = [item for item in found if item.kind == kind]
        if items:
            lost = sum(item.lost or 0 for item in items)
            cost = "" if all(item.lost is None for item in items) else f" ({lost} writes lost)"
            longest = max(item.seconds or 0.0 for item in items)
            how = f"{one} for" if len(items) == 1 else f"{several.format(len(items))}, longest"
            words.append(f"{how} {longest:.2f} s{cost}")
    return "; ".join(words)


def _print_streams(console: Console, streams: list[StreamQuality], *, is_whole: bool) -> None:
    """Print a row per key and writer; of the station's own keys only those that lack writes, unless all are wanted."""
    shown = [item for item in streams if is_whole or item.lost or not keys.is_bookkeeping(item.key)]
    columns = [
        Column("key", "left"),
        Column("writer", "left"),
        *map(Column, ("count", "lost", "rate", "jitter p99", "gap")),
    ]
    rows = [
        (
            plain(item.key),
            plain(item.writer),
            str(item.count),
            f"[red]{item.lost}[/]" if item.lost else ("0" if item.is_native else "–"),
            _unit(item.rate_hz, 1, "Hz"),
            _unit(item.jitter_p99_s, 1e3, "ms"),
            _unit(item.longest_gap_s, 1e3, "ms", digits=0),
        )
        for item in shown
    ]
    print_table(columns, rows)
    if left := len(streams) - len(shown):
        console.print(f"[dim]and {left} streams of the station's own, none with a write lost; --all shows them[/]")


def _print_steps(console: Console, steps: StepQuality, *, lock_step: bool) -> None:
    shares = ", ".join(f"{plain(state)} {share:.0%}" for state, share in steps.gate_shares.items())
    text = f"[bold]{plain(steps.robot)}[/]: {steps.steps} policy steps, {steps.missing_steps} missing; gate: {shares}"
    console.print(text, soft_wrap=True)
    if text := _error(steps):
        console.print(f"  {text}", soft_wrap=True)
    for line in steps.velocity.lines() if steps.velocity is not None else ():
        console.print(f"  {line}", soft_wrap=True)
    if lock_step:
        console.print("  [dim]lock-step: commands wait for states, so latencies say nothing of the control[/]")
        return
    columns = [Column("time between", "left"), *map(Column, ("p50", "p99", "max"))]
    spreads = {"command age at use": steps.command_age, **steps.stages}
    rows = [(name.replace("_to_", " → ").replace("_", " "), *_times(spread)) for name, spread in spreads.items()]
    print_table(columns, rows, indent=2)


def _print_cameras(console: Console, cameras: list[CameraQuality]) -> None:
    """Print what became of each camera's pictures."""
    if not cameras:
        return
    titles = ("pictures", "missing", "rate", "longest gap", "age at write p50", "p99")
    rows = [
        (
            plain(item.name), str(item.frames), f"[red]{item.missing}[/]" if item.missing else "0",
            _unit(item.rate_hz, 1, "Hz"), _unit(item.longest_gap_s, 1e3, "ms", digits=0),
            _unit(item.age_p50_s, 1e3, "ms"), _unit(item.age_p99_s, 1e3, "ms"),
        )
        for item in cameras
    ]  # fmt: skip
    console.print()
    print_table([Column("camera", "left"), *map(Column, titles)], rows)


def _print_pictures(console: Console, pictures: list[PictureQuality]) -> None:
    """Print what each camera's pictures are worth."""
    if not pictures:
        return
    titles = ("size", "torn", "repeats", "longest still", "looked at", "black", "white", "flat", "grey", "sharpness")
    colour = [item for item in pictures if item.depth is None]
    rows = [
        (
            *_bytes_of(item), _bad(item.black.count),
            _bad(item.white.count), _bad(item.flat.count), _unit(item.brightness, 1, "", digits=0).strip(),
            _unit(item.sharpness, 1, "", digits=0).strip(),
        )
        for item in colour
    ]  # fmt: skip
    if rows:
        console.print()
        print_table([Column("pictures", "left"), *map(Column, titles)], rows)
    rows = [
        (*_bytes_of(item), _bad(item.depth.blind.count), _percent(item.depth.measured_share))
        for item in pictures
        if item.depth is not None
    ]
    if rows:
        console.print()
        print_table([Column("depth", "left"), *map(Column, (*titles[:5], "blind", "measured"))], rows)
    if any(item.decoder == "pillow" for item in colour):
        console.print(
            "[dim]damage within a picture is seen by simplejpeg alone: pip install 'teleop-station\\[video]'[/]",
            soft_wrap=True,
        )


def _bytes_of(item: PictureQuality) -> tuple[str, ...]:
    """Return what the bytes of a camera's pictures are worth, as the first columns of its row."""
    return (
        plain(item.name), ", ".join(item.sizes) or "–", _bad(item.torn.count + item.unreadable.count),
        str(item.repeats), f"{item.still_s:.1f} s", str(item.looked_at),
    )  # fmt: skip


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{share:.0%}"


def _bad(count: int) -> str:
    return f"[red]{count}[/]" if count else "0"


def _print_arm(console: Console, arm: ArmQuality) -> None:
    """Print what the session with an arm's controller counted, in three lines."""
    console.print(
        f"  controller ({plain(arm.backend)}, {plain(', '.join(arm.profiles))}): "
        f"heartbeats {_unit(arm.sync_hz, 1, 'Hz')}, "
        f"targets sent {_unit(arm.sends_moving_hz, 1, 'Hz')} in motion ({arm.moving_s:.0f} s), "
        f"{_unit(arm.sends_holding_hz, 1, 'Hz')} at hold ({arm.holding_s:.0f} s)",
        soft_wrap=True,
    )
    sync = (_unit(value, 1e6, "us", digits=0) for value in (arm.sync_to_send_p50_s, arm.sync_to_send_p99_s))
    console.print(f"  heartbeat to send: p50 {next(sync)}, p99 {next(sync)}; heartbeats at most "
                  f"{_unit(arm.period_max_s, 1e3, 'ms')} apart", soft_wrap=True)  # fmt: skip
    counts = {"faults": arm.faults, "late commands": arm.late_commands, "missed ticks": arm.missed_ticks,
              "time-outs": arm.sync_timeouts, "refused at limits": arm.limit_refusals}  # fmt: skip
    console.print("  " + ", ".join(f"{count} {name}" for name, count in counts.items()), soft_wrap=True)


def _print_robot(console: Console, quality: Quality, robot: str) -> None:
    """Print the steps of a robot, how its joints moved, how commands lay beside states, what its controller counted."""
    for steps in (item for item in quality.steps if item.robot == robot):
        _print_steps(console, steps, lock_step=quality.lock_step)
    for item in (item for item in quality.motion if item.robot == robot):
        if all(steps.robot != robot for steps in quality.steps):
            console.print(f"[bold]{plain(robot)}[/]: {item.samples} states", soft_wrap=True)
        for line in _motion(item):
            console.print(f"  {line}", soft_wrap=True)
    for found in (found for found in quality.alignment if found.robot == robot):
        for line in _aligned(found, lock_step=quality.lock_step):
            console.print(f"  {line}", soft_wrap=True)
    for plausible in (item for item in quality.plausibility if item.robot == robot):
        for line in _plausible(plausible, lock_step=quality.lock_step):
            console.print(f"  {line}", soft_wrap=True)
    for arm in (arm for arm in quality.arms if arm.robot == robot):
        _print_arm(console, arm)


def _motion(item: MotionQuality) -> list[str]:
    lines = [f"still for {item.idle_head_s:.1f} s at the start and for {item.idle_tail_s:.1f} s at the end"]
    if item.jerk_p99_rad_s3 is not None:
        worst = f"most {plain(item.worst_jerk_joint)} {item.jerk_max_rad_s3 or 0.0:.0f}"
        lines.append(f"jerk p99 {item.jerk_p99_rad_s3:.0f} rad/s³, {worst}")
    if item.command_jerk_p99_rad_s3 is not None:
        joint = plain(item.command_worst_jerk_joint)
        lines.append(f"jerk of the command p99 {item.command_jerk_p99_rad_s3:.0f} rad/s³, most {joint}")
    if item.limit_joints:
        joints = ", ".join(f"{plain(joint)} {share:.1%}" for joint, share in list(item.limit_joints.items())[:3])
        lines.append(f"joints reached their limits {item.limit_hits} times: {joints} of the time")
    elif item.limits_from:
        lines.append("no joint reached its limit")
    return lines


def _aligned(found: Alignment, *, lock_step: bool) -> list[str]:
    lines = []
    if found.lag_s is not None and found.lag_correlation is not None:
        lines.append(
            f"joints follow the command by {found.lag_s * 1e3:z.0f} ms (correlation {found.lag_correlation:.2f})"
        )
    if found.lead_p50_s is not None and not lock_step:
        p50, p99 = _unit(found.lead_p50_s, 1e3, "ms"), _unit(found.lead_p99_s, 1e3, "ms")
        lines.append(f"each command was older than the state it was used with: by {p50} (p50), {p99} (p99)")
    if found.steps:
        lines.append(f"{found.repeated} steps reused the previous command; {found.skipped} commands were skipped")
    return lines


def _plausible(found: Plausibility, *, lock_step: bool) -> list[str]:
    """Return how far what a robot says of itself agrees; nothing where nothing could be compared."""
    words = []
    if found.orientation_agreement:
        words.append(f"gyro and orientation agree by {min(found.orientation_agreement.values()):.2f} or more")
    if found.velocity_agreement:
        worst = min(found.velocity_agreement, key=found.velocity_agreement.__getitem__)
        words.append(f"velocities and positions by {found.velocity_agreement[worst]:.2f} or more ({plain(worst)})")
    lines = [", ".join(words)] if words else []
    if found.times is not None and found.times.state_off_s is not None and not lock_step:
        offsets = {"states": found.times.state_off_s, "commands": found.times.command_off_s}
        told = [f"{what} {round(off_s * 1e3):+d} ms" for what, off_s in offsets.items() if off_s is not None]
        lines.append(f"time stamps against the recorded instants of the steps: {', '.join(told)}")
    return lines


def _error(steps: StepQuality) -> str:
    """Return how near a robot came to its commands; nothing where none was compared."""
    if steps.mean_joint_error_rad is None:
        return ""
    height_m = steps.mean_root_height_error_m
    return (
        f"mean joint error {steps.mean_joint_error_rad:.3f} rad over {steps.compared_steps} steps "
        f"(worst {plain(steps.worst_joint)} {steps.worst_joint_error_rad:.3f} rad)"
        + ("" if height_m is None else f"; mean height error {height_m:.3f} m")
    )


def _times(spread: Spread) -> tuple[str, str, str]:
    p50, p99, top = (_unit(value, 1e3, "ms", digits=2) for value in (spread.p50_s, spread.p99_s, spread.max_s))
    return p50, p99, top


def _unit(value: float | None, scale: float, unit: str, *, digits: int = 1) -> str:
    return "–" if value is None else f"{value * scale:.{digits}f} {unit}"
