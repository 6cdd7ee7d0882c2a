"""What a check found, for a person."""

from __future__ import annotations

from rich.console import Console

from station.cli.tables import Column, plain, print_table
from station.episode.quality import Interruption, Quality, Spread, StepQuality, StreamQuality

_MOST_ROWS = 20
_KINDS = {
    "bus-silent": ("silent once", "silent {} times"),
    "bus-lost": ("lost once", "lost {} times"),
    "bus-refused": ("refused writes once", "refused writes {} times"),
    "watch-cut": ("unheard by a server once", "unheard by servers {} times"),
    "tap-cut": ("recording link cut once and resumed,", "recording link cut {} times and resumed"),
    "hole": ("1 hole in the recording,", "{} holes in the recording"),
    "recorder-restart": ("recorder restarted once, away", "recorder restarted {} times"),
}
_COLOURS = {"good": "green", "usable": "yellow", "reject": "red"}


def print_quality(quality: Quality) -> None:
    """Print verdict, reasons, streams and steps."""
    console = Console(highlight=False)
    colour = _COLOURS[quality.verdict]
    console.print(
        f"[bold]{plain(quality.episode_id)}[/]: [{colour}]{quality.verdict}[/]   {_headline(quality)}", soft_wrap=True
    )
    for reason in quality.reasons:
        console.print(
            f"  [{_COLOURS[reason.verdict]}]{reason.verdict}[/] {reason.rule}: {plain(reason.text)}", soft_wrap=True
        )
    _print_interruptions(console, quality)
    console.print()
    _print_streams(quality.streams)
    for steps in quality.steps:
        console.print()
        _print_steps(console, steps, lock_step=quality.lock_step)


def _headline(quality: Quality) -> str:
    lost = sum(stream.lost for stream in quality.streams)
    dropped = f", {quality.dropped} dropped" if quality.dropped else ""
    tap = f"{plain(quality.backend or 'unknown')} tap{'' if quality.is_lossless else ' (lossy)'}"
    return (
        f"{quality.duration_s:.1f} s, {quality.messages} messages, {lost} lost{dropped}, {quality.falls} falls, "
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
    """Say in a line what the interruptions were, and what they cost."""
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


def _print_streams(streams: list[StreamQuality]) -> None:
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
        for item in streams
    ]
    print_table(columns, rows)


def _print_steps(console: Console, steps: StepQuality, *, lock_step: bool) -> None:
    shares = ", ".join(f"{plain(state)} {share:.0%}" for state, share in steps.gate_shares.items())
    text = f"[bold]{plain(steps.robot)}[/]: {steps.steps} policy steps, {steps.missing_steps} missing; gate: {shares}"
    console.print(text, soft_wrap=True)
    if steps.mean_joint_error_rad is not None:
        console.print(
            f"  mean joint error {steps.mean_joint_error_rad:.3f} rad over {steps.compared_steps} steps "
            f"(worst {plain(steps.worst_joint)} {steps.worst_joint_error_rad:.3f} rad)"
            + _height(steps.mean_root_height_error_m),
            soft_wrap=True,
        )
    if lock_step:
        console.print("  [dim]lock-step: commands wait for states, so latencies say nothing of the control[/]")
        return
    columns = [Column("time between", "left"), *map(Column, ("p50", "p99", "max"))]
    spreads = {"command age at use": steps.command_age, **steps.stages}
    rows = [(name.replace("_to_", " → ").replace("_", " "), *_times(spread)) for name, spread in spreads.items()]
    print_table(columns, rows, indent=2)


def _height(error_m: float | None) -> str:
    return "" if error_m is None else f"; mean height error {error_m:.3f} m"


def _times(spread: Spread) -> tuple[str, str, str]:
    p50, p99, top = (_unit(value, 1e3, "ms", digits=2) for value in (spread.p50_s, spread.p99_s, spread.max_s))
    return p50, p99, top


def _unit(value: float | None, scale: float, unit: str, *, digits: int = 1) -> str:
    return "–" if value is None else f"{value * scale:.{digits}f} {unit}"
