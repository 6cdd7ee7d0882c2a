"""The tables of an episode's section: latencies, motion, cameras, streams, and where it comes from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from station.episode.quality.findings import Quality, Spread, StreamQuality
from station.report.gather import Episode
from station.report.html import Child, Html, join, table, tag

_MOST_STREAMS = 80
_MOST_ROWS = 40
_LEAST_SCALE_S = 0.02  # of the bars; a millisecond must not look like a fault
_SHORT = {"command_written": "command written", "command_arrived": "arrived", "state_read": "state read"}


def latency(quality: Quality) -> Html | None:
    """Return the time between the instants of a policy step, and the command's age."""
    parts = []
    for steps in quality.steps:
        if quality.lock_step:
            parts.append(
                tag("p", "In lock-step commands wait for states, so times say nothing of the control.", class_="soft")
            )
            continue
        spreads = {"age of the command at use": steps.command_age, **{words(k): v for k, v in steps.stages.items()}}
        top = max([*(spread.p99_s or 0.0 for spread in spreads.values()), _LEAST_SCALE_S])
        rows = [
            (name, *(_ms(value) for value in (s.p50_s, s.p99_s, s.max_s)), _bar(s, top)) for name, s in spreads.items()
        ]
        parts.append(table(("", "p50", "p99", "max", f"0 to {top * 1e3:.0f} ms"), rows, class_="numbers"))
    return join([tag("h3", "Latency of each stage"), *parts]) if parts else None


def words(stage: str) -> str:
    """Return a stage's name as people say it."""
    return stage.replace("_to_", " → ").replace("_", " ")


def motion(quality: Quality) -> Html | None:
    """Return how the robot moved and followed, a row for each finding."""
    rows: list[tuple[str, str]] = []
    for steps in quality.steps:
        shares = ", ".join(f"{state} {share:.0%}" for state, share in steps.gate_shares.items())
        rows.append(("policy steps", f"{steps.steps}, {steps.missing_steps} missing; gate: {shares}"))
        if steps.mean_joint_error_rad is not None:
            worst = f"{steps.worst_joint.replace('_', ' ')} {steps.worst_joint_error_rad or 0.0:.3f} rad"
            rows.append(("mean joint error", f"{steps.mean_joint_error_rad:.3f} rad, worst {worst}"))
        if steps.mean_root_height_error_m is not None:
            rows.append(("mean height error", f"{steps.mean_root_height_error_m * 1e3:.0f} mm"))
        if steps.velocity is not None:
            rows.append(("velocity", steps.velocity.in_short))
            rows += [(f"velocity from {each.at_s:.1f} s", each.in_short) for each in steps.velocity.stretches]
    for found in quality.alignment:
        if found.lag_s is not None:
            rows.append(
                (
                    "joints follow the command by",
                    f"{found.lag_s * 1e3:z.0f} ms (agreement {found.lag_correlation or 0.0:.2f})",
                )
            )
        if found.lead_p50_s is not None and not quality.lock_step:
            rows.append(
                (
                    "command written before its state was read",
                    f"p50 {_ms(found.lead_p50_s)}, p99 {_ms(found.lead_p99_s)}",
                )
            )
        rows.append(("commands used twice · not used", f"{found.repeated} · {found.skipped}"))
    for item in quality.motion:
        rows.append(("nothing moves", f"in the first {item.idle_head_s:.1f} s and the last {item.idle_tail_s:.1f} s"))
        if item.jerk_p99_rad_s3 is not None:
            worst = item.worst_jerk_joint.replace("_", " ")
            rows.append(
                ("jerk", f"p99 {item.jerk_p99_rad_s3:.0f} rad/s³, most {item.jerk_max_rad_s3 or 0.0:.0f} ({worst})")
            )
        if item.command_jerk_p99_rad_s3 is not None:
            worst = item.command_worst_jerk_joint.replace("_", " ")
            rows.append(("jerk of the command", f"p99 {item.command_jerk_p99_rad_s3:.0f} rad/s³ ({worst})"))
        if item.limits_from:
            ends = ", ".join(
                f"{joint.replace('_', ' ')} {share:.1%}" for joint, share in list(item.limit_joints.items())[:3]
            )
            rows.append(("joints at their ends", f"{item.limit_hits} times: {ends} of the time" if ends else "never"))
    return join([tag("h3", "Motion and tracking"), table((), rows)]) if rows else None


def arms(quality: Quality) -> Html | None:
    """Return what each arm's session with its controller counted."""
    tables = [
        table((), [
            ("controller", ", ".join([arm.backend, *arm.profiles])),
            ("heartbeats", f"{_hz(arm.sync_hz)}, at most {_ms(arm.period_max_s)} apart"),
            ("targets sent in motion", f"{_hz(arm.sends_moving_hz)} over {arm.moving_s:.1f} s"),
            ("targets sent at hold", f"{_hz(arm.sends_holding_hz)} over {arm.holding_s:.1f} s"),
            ("heartbeat to send", f"p50 {_us(arm.sync_to_send_p50_s)}, p99 {_us(arm.sync_to_send_p99_s)}"),
            ("faults · refused at limits", f"{arm.faults} · {arm.limit_refusals}"),
            ("late commands · missed ticks · time-outs",
             f"{arm.late_commands} · {arm.missed_ticks} · {arm.sync_timeouts}"),
        ])
        for arm in quality.arms
    ]  # fmt: skip
    return join([tag("h3", "The arm and its controller"), *tables]) if tables else None


def cameras(quality: Quality) -> Html | None:
    """Return what became of each camera's pictures."""
    if not quality.cameras:
        return None
    head = ("camera", "pictures", "missing", "of them by number", "rate", "longest gap", "age at write, p50", "p99")
    rows = [
        (item.name, str(item.frames), _count(item.missing), str(item.lost), _hz(item.rate_hz), _ms(item.longest_gap_s),
         _ms(item.age_p50_s), _ms(item.age_p99_s))
        for item in quality.cameras[:_MOST_ROWS]
    ]  # fmt: skip
    shown = ("camera", "size", "torn", "repeats", "longest still", "looked at", "black", "white", "flat", "grey")
    worth = [
        (item.name, ", ".join(item.sizes) or "–", _count(item.torn.count + item.unreadable.count), str(item.repeats),
         f"{item.still_s:.1f} s", str(item.looked_at), _count(item.black.count), _count(item.white.count),
         _count(item.flat.count), "–" if item.brightness is None else f"{item.brightness:.0f}")
        for item in quality.pictures[:_MOST_ROWS]
        if item.depth is None
    ]  # fmt: skip
    seen = ("depth", "size", "torn", "repeats", "longest still", "looked at", "blind", "measured")
    depths = [
        (item.name, ", ".join(item.sizes) or "–", _count(item.torn.count + item.unreadable.count), str(item.repeats),
         f"{item.still_s:.1f} s", str(item.looked_at), _count(item.depth.blind.count),
         "–" if item.depth.measured_share is None else f"{item.depth.measured_share:.0%}")
        for item in quality.pictures[:_MOST_ROWS]
        if item.depth is not None
    ]  # fmt: skip
    tables = [table(titles, lines, class_="numbers")
              for titles, lines in ((head, rows), (shown, worth), (seen, depths)) if lines]  # fmt: skip
    return join([tag("h3", "Cameras"), *tables])


def streams(found: Sequence[StreamQuality]) -> Html:
    """Return every stream with its counts and times."""
    head = ("key", "writer", "role", "count", "lost", "dropped", "rate", "jitter p99", "longest gap")
    rows = [
        (tag("code", item.key), item.writer, item.role, str(item.count), _count(item.lost) if item.is_native else "–",
         _count(item.dropped), _hz(item.rate_hz), _ms(item.jitter_p99_s), _ms(item.longest_gap_s))
        for item in found[:_MOST_STREAMS]
    ]  # fmt: skip
    more = len(found) - _MOST_STREAMS
    return join(
        [table(head, rows, class_="numbers"), tag("p", f"and {more} more", class_="soft") if more > 0 else None]
    )


def provenance(episode: Episode) -> Html:
    """Return who and what made an episode, with the hashes that pin it, and the verbs that look closer."""
    manifest, quality = episode.manifest, episode.quality
    operator, policy, facts, code = manifest.operator, manifest.policy, manifest.robot.facts, manifest.recorder.software
    driven = f"{policy.name} on {policy.runtime}, {policy.rate_hz or 0:g} Hz, follows {policy.command}"
    plain = (str, int, float)
    asked = {key: value for key, value in manifest.runbook.items() if isinstance(value, plain) and key != "text"}
    lossy = "" if quality.is_lossless else " (lossy)"
    dirty = " with changes" if code.get("dirty") else ""
    rows: list[tuple[str, Child]] = [
        ("folder", tag("code", str(episode.folder))),
        ("operator", f"{operator.id or '–'}, interface {operator.interface or '–'}{_pairs(operator.details)}"),
        ("commands", _commands(quality)),
        ("policy", driven if policy.name else None),
        ("checkpoint", _hashed(policy.checkpoint, policy.sha256)),
        ("robot model", _hashed(facts.get("model", ""), facts.get("model_sha256", ""))),
        *(("motion", _hashed(item.get("file", ""), item.get("sha256", ""))) for item in manifest.motions[:_MOST_ROWS]),
        ("runbook", _pairs(asked, "")),
        ("recorded by", f"{quality.backend} tap{lossy}, {quality.recorder_restarts} restarts"),
        ("software", f"{code.get('version', '')} {code.get('revision', '')}{dirty}".strip()),
        *(("judged by", _hashed(rules.file, rules.sha256)) for rules in quality.rules[:_MOST_ROWS]),
        ("look closer", [[tag("code", f"station {verb}"), tag("br")] for verb in _verbs(episode)]),
    ]
    return table((), [(name, value) for name, value in rows if value])


def _verbs(episode: Episode) -> Iterable[str]:
    name = str(episode.folder)
    return (f"check {name}", f"view {name}", f"audit {name}", f"replay {name} --to sim")


def _commands(quality: Quality) -> str:
    keys = [f"{item.key} by {item.writer} ({item.count})" for item in quality.streams if item.role == "command"]
    return ", ".join(keys[:_MOST_ROWS])


def _hashed(name: object, sha256: object) -> Html | None:
    if not name and not sha256:
        return None
    return join([tag("code", str(name)), tag("br"), tag("code", f"sha256 {sha256}", class_="soft") if sha256 else None])


def _pairs(found: Mapping[str, Any], begin: str = ", ") -> str:
    shown = ", ".join(f"{key} {value}" for key, value in found.items())
    return begin + shown if shown else ""


def _bar(spread: Spread, top_s: float) -> Html:
    """Return p50 as a bar over that of p99."""
    widths = [100.0 * min(1.0, max(0.0, value or 0.0) / top_s) for value in (spread.p99_s, spread.p50_s)]
    return tag("div", [tag("i", "", style=f"width:{width:.1f}%") for width in widths], class_="bar")


def _count(number: int) -> Html | str:
    return tag("span", str(number), class_="bad") if number else "0"


def _ms(value_s: float | None) -> str:
    return "–" if value_s is None else f"{value_s * 1e3:.1f} ms" if abs(value_s) < 10.0 else f"{value_s:.1f} s"


def _us(value_s: float | None) -> str:
    return "–" if value_s is None else f"{value_s * 1e6:.0f} µs"


def _hz(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f} Hz"
