"""From what was found to a verdict: one small function per rule, each silent where it has nothing to say."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from station.bus import keys
from station.episode.quality.cameras import told_apart
from station.episode.quality.finding_parts import KeyChanges, KeyPresence, Loss, LossKind
from station.episode.quality.findings import Interruption, Quality, Reason, StepQuality, StreamQuality, Verdict
from station.episode.quality.rule_file import Ends, GradedRule, Limits, Rule
from station.episode.quality.sensed_rules import GAP_PERIODS, SENSED, Finder
from station.episode.quality.state_rules import PLAUSIBLE
from station.episode.quality.timing import not_judged
from station.episode.storage import pictures
from station.episode.storage.file_hashes import words

_JUDGED_ROLES = ("command", "state", "policy")

_NAMED = 5  # keys of a finding that are listed
_DESCRIBED = ("command", "state", "policy", "sensor")
_SENSORS: dict[LossKind, str] = {"camera-lost": "camera", "lidar-lost": "lidar"}
_OF_THE_ROBOT = ("state", "policy")
_ANY_HZ = 1e9
_LAST_S = 0.005
_SHORTEST_S = 1e-3  # of an episode; keeps a share finite


def judge(quality: Quality, limits: Limits) -> tuple[Verdict, list[Reason]]:
    """Return the verdict of an episode and every reason against a better one.

    Rules that its times cannot answer are not asked (`station.episode.quality.timing`).
    """
    silent = not_judged(quality)
    reasons = [
        Reason(name, said, text)
        for name, find in RULES.items()
        if name not in silent
        for found, text in find(quality, limits)
        if (said := _said(found, limits.rule(name))) is not None
    ]
    verdicts = {reason.verdict for reason in reasons}
    return ("reject" if "reject" in verdicts else "usable" if "usable" in verdicts else "good"), reasons


def _said(found: Verdict, rule: Rule) -> Verdict | None:
    """Return what a rule is to say, or None for one that is off; a graded one says no worse than it was given."""
    if rule.verdict == "off":
        return None
    return found if isinstance(rule, GradedRule) and rule.verdict == "reject" else rule.verdict


def _empty(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if not quality.messages:
        yield "reject", "no message in the file"


def _torn(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if quality.torn is not None:
        yield "reject", f"the file is torn ({quality.torn}); what is whole of it can still be shown and replayed"


def _unfinished(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if not quality.is_finished and quality.torn is None:
        yield "reject", "the recorder has not closed the file"


def _changed(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for change in quality.changed:
        yield "reject", f"the recording was changed after it was closed: {words([change])}"


def _manifest_changed(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if fields := quality.manifest_changed:
        yield "reject", f"the manifest says other than the recording itself, in {_listed(fields)}"


def _audit_differs(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for one in quality.audit.differences if quality.audit is not None else ():
        share = f"{one.different} of {one.compared}" if one.compared else f"{one.different}"
        text = f"{one.key}: {share} values are not what {' and '.join(one.of)} give again"
        yield "reject", text if one.first_s is None else f"{text}, the first at {one.first_s:.2f} s"


def _discarded(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if quality.discarded:
        yield "reject", "marked as discarded"


def _failed_task(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if quality.success is False:
        yield "reject", "the operator said that the task failed"


def _fell(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if quality.falls_seen:
        first = quality.falls_seen[0]
        yield "reject", f"{quality.falls} fall(s), the first at {first.at_s:.2f} s (seen by {first.seen_by})"


def _lost(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for writer, streams in _by_writer([stream for stream in quality.streams if stream.lost]).items():
        worst = max(streams, key=lambda stream: stream.lost)
        share = max(_lost_share(stream) for stream in streams)
        verdict: Verdict = "reject" if share > limits.lost.reject_above_share else "usable"
        where = "" if worst.lost_at_s is None else f", the first at {worst.lost_at_s:.2f} s"
        text = f"{_named(worst)}: {worst.lost} of {worst.lost + worst.count} writes are missing{where}"
        if len(streams) > 1:
            total = sum(stream.lost for stream in streams)
            text += f"; {total} in all {len(streams)} streams of {writer} that lack some"
        yield verdict, text


def _dropped(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if signals := quality.dropped - quality.dropped_bulky:
        yield "reject", f"the recorder dropped {signals} writes that were no images ({_dropped_keys(quality)})"


def _dropped_images(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if bulky := quality.dropped_bulky:
        yield "usable", f"the recorder dropped {bulky} images or other bulky values ({_dropped_keys(quality)})"


def _dropped_keys(quality: Quality) -> str:
    return ", ".join(f"{key} {count}" for key, count in quality.dropped_keys.items()) or "of which is not known"


def _disordered(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for stream in quality.streams:
        if stream.repeated or stream.out_of_order:
            yield "usable", f"{_named(stream)}: {stream.repeated} repeated, {stream.out_of_order} out of order"


def _lossy_tap(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if not quality.is_lossless:
        who = quality.backend or "an unnamed tap"
        said = (
            "cannot promise every foreign write"
            if quality.times_of == "writers"
            else "polled: what came between is lost"
        )
        yield "usable", f"recorded by {who}, which {said}"


def _holes(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if quality.holes:
        first = next((item for item in quality.interruptions if item.kind == "hole"), None)
        where = f", the first {_when(first)}: {first.reason or 'the recorder does not say why'}" if first else ""
        yield "reject", f"{quality.holes} hole(s){where}"


def _gap(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    silent = [stream for stream in _timed(quality) if (stream.longest_gap_s or 0.0) > limits.gap.usable_above_s]
    for streams in _by_writer(silent).values():
        worst = max(streams, key=lambda stream: stream.longest_gap_s or 0.0)
        gap_s = worst.longest_gap_s or 0.0
        verdict: Verdict = "reject" if gap_s > limits.gap.reject_above_s else "usable"
        others = f"; at most that long: {len(streams) - 1} more of its streams" if len(streams) > 1 else ""
        where = f"for {gap_s:.3f} s from {worst.gap_at_s or 0.0:.2f} s on"
        yield verdict, f"{_named(worst)}: silent {where} (limit {limits.gap.usable_above_s:g} s){others}"


def _device_gap(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for stream in _devices(quality, lambda one: one.longest_gap_s or 0.0):
        gap_s, at_s = stream.longest_gap_s or 0.0, stream.gap_at_s or 0.0
        is_last = at_s + gap_s > stream.last_s - _LAST_S  # before its word that the device's server has ended
        if gap_s > limits.device_gap.above_s and not is_last:
            yield "usable", f"{_named(stream)}: silent for {gap_s:.3f} s from {at_s:.2f} s on"


def _device_slow(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for stream in _devices(quality, lambda one: one.slowest_s or 0.0):
        slowest_s = stream.slowest_s or 0.0
        if slowest_s > limits.device_slow.above_s:
            where = f"took {slowest_s:.2f} s from {stream.slowest_at_s or 0.0:.2f} s on"
            yield "usable", f"{_named(stream)}: the writes of one second {where}: it was starved, or paused in turns"


def _devices(quality: Quality, worst: Callable[[StreamQuality], float]) -> list[StreamQuality]:
    """Return of each operator's device the stream that is worst, of those that it writes at a rate."""
    cameras = {camera.key for camera in quality.cameras}
    streams = [one for one in quality.streams if one.role == "sensor" and one.nominal_hz and one.key not in cameras]
    return [max(group, key=worst) for group in _by_writer(streams).values()]


def _server_paused(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for one in quality.silences:
        if one.seconds > limits.server_paused.above_s:
            where = f"did not say that it works for {one.seconds:.2f} s from {one.at_s:.2f} s on"
            yield "usable", f"server {one.server} ({keys.server(one.server)}): {where}: it was paused, or starved"


def _slow(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    slow = [stream for stream in _timed(quality) if _steady_share(stream) < limits.slow.below_share]
    for streams in _by_writer(slow).values():
        worst = min(streams, key=_steady_share)
        rate_hz = _steady_share(worst) * (worst.nominal_hz or 0.0)
        others = f"; {len(streams) - 1} other streams of it are slow too" if len(streams) > 1 else ""
        yield "usable", f"{_named(worst)}: {rate_hz:.1f} Hz, nominal {worst.nominal_hz:g} Hz{others}"


def _rivals(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for rival in quality.rivals:
        yield "reject", f"{rival.key}: written by {' and '.join(rival.writers)} at once for {rival.overlap_s:.2f} s"


def _bus_silent(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    yield from _interrupted_bus(quality, "bus-silent", "the bus was silent")


def _bus_lost(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    yield from _interrupted_bus(quality, "bus-lost", "the bus was lost")


def _bus_refused(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    yield from _interrupted_bus(quality, "bus-refused", "the bus refused writes")


def _interrupted_bus(quality: Quality, kind: str, what: str) -> Iterator[tuple[Verdict, str]]:
    found = [item for item in quality.interruptions if item.kind == kind]
    if found:
        yield "usable", f"{what} {len(found)} time(s), first {_when(found[0])}"


def _reset(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if quality.resets:
        yield "usable", f"the operator reset the robot {quality.resets} time(s)"


def _estop(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if quality.estops:
        yield "reject", f"{quality.estops} emergency stop(s)"


def _no_steps(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if not any(robot.steps for robot in quality.steps):
        of = " and ".join(robot.robot for robot in quality.motion)
        text = "nothing to audit, and training data of it needs --state and --action"
        yield "usable", f"no policy step{f' of {of}' * bool(of)} in the file: {text}"


def _incomplete_steps(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.steps:
        for key, seen in robot.lacking.items():
            share = seen.count / robot.steps
            if share > limits.incomplete_steps.usable_above_share:
                verdict: Verdict = "reject" if share > limits.incomplete_steps.reject_above_share else "usable"
                where = f"the first at {seen.first_s or 0.0:.2f} s"
                yield verdict, f"{key}: {seen.count} of {robot.steps} steps lack it, {where}; a step writes all at once"


def _missing_keys(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    written = {stream.key for stream in quality.streams}
    for robot in (steps.robot for steps in quality.steps if steps.steps):
        wanted = {
            "states": (keys.robot_state(robot), keys.state_joints(robot)),
            "applied commands": (keys.command_used(robot),),
        }
        for what, known in wanted.items():
            if written.isdisjoint(known):
                yield "reject", f"{robot}: policy steps and none of their {what} ({' or '.join(known)}) in the file"


def _never_tracked(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.steps:
        if robot.steps and not robot.gate_shares.get("tracking"):
            told = _shares(robot) or f"nothing tells what it did: no {keys.command_gate(robot.robot)} in the file"
            yield "reject", f"{robot.robot}: the gate never let a command through ({told})"


def _commands_ended(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    if quality.pauses:
        first, more = quality.pauses[0], len(quality.pauses) - 1
        again = f"; {more} more time(s), {sum(one.seconds for one in quality.pauses):.1f} s in all" if more else ""
        yield "usable", f"commands ended at {first.at_s:.1f} s for {first.seconds:.1f} s: {first.reason}{again}"


def _interrupted(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.steps:
        if robot.interrupted_share > limits.interrupted.usable_above_share:
            verdict: Verdict = "reject" if robot.interrupted_share > limits.interrupted.reject_above_share else "usable"
            yield verdict, f"{robot.robot}: {robot.interrupted_share:.1%} of the run without command ({_shares(robot)})"


def _old_command(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.steps:
        age_s = robot.command_age.p99_s
        if age_s is not None and age_s > limits.old_command.p99_above_s:
            yield "usable", f"{robot.robot}: commands {age_s * 1e3:.0f} ms old at use (p99)"


def _poor_tracking(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.steps:
        error = robot.mean_joint_error_rad
        if error is not None and error > limits.poor_tracking.usable_above_rad:
            verdict: Verdict = "reject" if error > limits.poor_tracking.reject_above_rad else "usable"
            yield verdict, f"{robot.robot}: mean joint error {error:.3f} rad, worst {robot.worst_joint}"


def _wrong_height(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    for robot in quality.steps:
        error = robot.mean_root_height_error_m
        if error is not None and error > limits.wrong_height.above_m:
            yield "usable", f"{robot.robot}: mean root height error {error:.3f} m"


"""Every rule by the name that a reason carries."""


def _timed(quality: Quality) -> Iterator[StreamQuality]:
    """Streams whose timing matters."""
    for stream in quality.streams:
        if stream.role in _JUDGED_ROLES and stream.nominal_hz is not None:
            yield stream


def _steady_share(stream: StreamQuality) -> float:
    """Rate of its nominal one, without the longest silence and without pauses, which have rules of their own.

    1 where it cannot be told.
    """
    steady_s = stream.last_s - stream.first_s - stream.paused_s - (stream.longest_gap_s or 0.0)
    if stream.count <= 2 or steady_s <= 0 or not stream.nominal_hz:
        return 1.0
    return (stream.count - 2) / steady_s / stream.nominal_hz


def _when(item: Interruption) -> str:
    lasted = "to the end" if item.seconds is None else f"for {item.seconds:.2f} s"
    return f"at {item.at_s:.2f} s {lasted}" + (f", {item.lost} writes lost" if item.lost else "")


def _by_writer(streams: list[StreamQuality]) -> dict[str, list[StreamQuality]]:
    """Group streams by their writers: one that stumbles does so with all its keys, and is one reason."""
    found: dict[str, list[StreamQuality]] = {}
    for stream in streams:
        found.setdefault(stream.writer, []).append(stream)
    return found


def _lost_share(stream: StreamQuality) -> float:
    return stream.lost / (stream.lost + stream.count)


def _named(stream: StreamQuality) -> str:
    return f"{stream.key} by {stream.writer}"


def _shares(robot: StepQuality) -> str:
    return ", ".join(f"{state} {share:.0%}" for state, share in sorted(robot.gate_shares.items()))


def _began_late(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    found = [one for one in _of_streams(quality) if one.role in _OF_THE_ROBOT and one.late_s > 0]
    yield from _at_an_end(quality, found, limits.began_late, lambda one: one.late_s, "nothing in the first")


def _ended_early(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    # What commanded in the pre-roll alone was over before the episode began; of a robot it would be missing.
    found = [
        one
        for one in _of_streams(quality)
        if one.role in _OF_THE_ROBOT or (not one.is_end_told and one.early_s <= _length_s(quality))
    ]
    yield from _at_an_end(quality, found, limits.ended_early, lambda one: one.early_s, "nothing in the last")


def _camera_began_late(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    yield from _camera_at_an_end(quality, limits.camera_began_late, lambda one: one.late_s, "no picture in the first")


def _camera_ended_early(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    yield from _camera_at_an_end(quality, limits.camera_ended_early, lambda one: one.early_s, "no picture in the last")


def _camera_at_an_end(
    quality: Quality, limit: Ends, missing_s: Callable[[KeyPresence], float], what: str
) -> Iterator[tuple[Verdict, str]]:
    of_key = {one.key: one for one in quality.presence}
    for camera in told_apart(quality.cameras):
        one, periods_s = of_key.get(camera.key), GAP_PERIODS / (camera.nominal_hz or _ANY_HZ)
        if one is not None and missing_s(one) > max(limit.usable_above_s, periods_s):
            share = missing_s(one) / _length_s(quality)
            verdict: Verdict = "reject" if share > limit.reject_above_share else "usable"
            yield verdict, f"camera {camera.name}: {what} {missing_s(one):.1f} s ({share:.0%} of the episode)"


def _at_an_end(
    quality: Quality, found: Iterable[KeyPresence], limit: Ends, missing_s: Callable[[KeyPresence], float], what: str
) -> Iterator[tuple[Verdict, str]]:
    """Yield a reason for each writer and role of which something is missing, by the key that misses most."""
    groups: dict[tuple[str, str], list[KeyPresence]] = {}
    for one in found:
        if missing_s(one) > limit.usable_above_s:
            groups.setdefault((one.writer, one.role if one.role not in _OF_THE_ROBOT else ""), []).append(one)
    for group in groups.values():
        worst = max(group, key=missing_s)
        share = missing_s(worst) / _length_s(quality)
        is_robot = worst.role in _OF_THE_ROBOT
        verdict: Verdict = "reject" if is_robot and share > limit.reject_above_share else "usable"
        others = f"; at most that long: {len(group) - 1} more of its keys" if len(group) > 1 else ""
        text = f"{worst.key} by {worst.writer}: {what} {missing_s(worst):.1f} s ({share:.0%} of the episode){others}"
        yield verdict, text


def _writer_gap(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    found = [one for one in _of_streams(quality) if one.role in _OF_THE_ROBOT]
    worst = max(found, key=lambda one: one.between_s, default=None)
    if worst is not None and worst.between_s > limits.writer_gap.usable_above_s:
        verdict: Verdict = "reject" if worst.between_s > limits.writer_gap.reject_above_s else "usable"
        yield verdict, f"{worst.key}: silent for {worst.between_s:.2f} s until another process wrote it"


def _server_died(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for server, losses in _by_server(one for one in quality.losses if one.kind not in _SENSORS).items():
        verdict: Verdict = "reject" if losses[0].role == "low-level" else "usable"
        yield verdict, f"server {server} at {losses[0].at_s:.2f} s: {losses[0].kind}, {losses[0].reason}{_more(losses)}"


def _camera_lost(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for kind, sensor in _SENSORS.items():
        for server, losses in _by_server(one for one in quality.losses if one.kind == kind).items():
            yield "usable", f"{sensor} {server} lost at {losses[0].at_s:.2f} s: {losses[0].reason}{_more(losses)}"


def _no_pictures(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for key in quality.no_pictures:
        lidar = key.removeprefix(keys.lidar_cloud(""))
        what, one = (f"camera {pictures.title_of(key)}", "picture") if lidar == key else (f"lidar {lidar}", "cloud")
        yield "reject", f"{what}: its server lived, and there is no {one} of it"


def _of_streams(quality: Quality) -> list[KeyPresence]:
    cameras = {camera.key for camera in quality.cameras}
    return [one for one in quality.presence if one.key not in cameras]


def _length_s(quality: Quality) -> float:
    from_s, to_s = quality.ends_s
    return max(to_s - from_s, _SHORTEST_S)


def _by_server(losses: Iterable[Loss]) -> dict[str, list[Loss]]:
    found: dict[str, list[Loss]] = {}
    for loss in losses:
        found.setdefault(loss.server, []).append(loss)
    return found


def _more(losses: list[Loss]) -> str:
    return f"; {len(losses) - 1} more such event(s)" if len(losses) > 1 else ""


def _not_mirrored(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    known = [one for one in quality.not_mirrored if not one.key or one.role is not None]
    others = [one for one in quality.not_mirrored if one.key and one.role is None]
    graded: list[tuple[Verdict, list[KeyChanges]]] = [("reject", known), ("usable", others)]
    for verdict, found in graded:
        if found:
            count, first = sum(one.count for one in found), min(one.at_s for one in found)
            what = _listed([f"{one.key or 'an unknown key'} by {one.command} {one.count}" for one in found])
            yield verdict, f"{count} write(s) on the bus are not in the file, the first at {first:.2f} s: {what}"


def _deleted(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    found = [one for one in quality.deletions if one.role in _DESCRIBED]
    if found:
        count, first = sum(one.count for one in found), min(one.at_s for one in found)
        what = _listed([_times(one) for one in found])
        yield "usable", f"{count} deletion(s) of keys, the first at {first:.2f} s: {what}"


def _times(found: KeyChanges) -> str:
    return found.key if found.count == 1 else f"{found.key} {found.count} times"


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more


RULES: dict[str, Finder] = {
    "empty": _empty,
    "torn": _torn,
    "unfinished": _unfinished,
    "changed": _changed,
    "manifest-changed": _manifest_changed,
    "audit-differs": _audit_differs,
    "discarded": _discarded,
    "failed-task": _failed_task,
    "fell": _fell,
    "lost": _lost,
    "dropped": _dropped,
    "dropped-images": _dropped_images,
    "disordered": _disordered,
    "lossy-tap": _lossy_tap,
    "holes": _holes,
    "gap": _gap,
    "device-gap": _device_gap,
    "device-slow": _device_slow,
    "server-paused": _server_paused,
    "slow": _slow,
    "rival-writers": _rivals,
    "bus-silent": _bus_silent,
    "bus-lost": _bus_lost,
    "bus-refused": _bus_refused,
    "began-late": _began_late,
    "ended-early": _ended_early,
    "writer-gap": _writer_gap,
    "server-died": _server_died,
    "no-pictures": _no_pictures,
    "camera-began-late": _camera_began_late,
    "camera-ended-early": _camera_ended_early,
    "camera-lost": _camera_lost,
    "not-mirrored": _not_mirrored,
    "deleted": _deleted,
    **SENSED,
    **PLAUSIBLE,
    "operator-reset": _reset,
    "estop": _estop,
    "no-steps": _no_steps,
    "missing-keys": _missing_keys,
    "incomplete-steps": _incomplete_steps,
    "never-tracked": _never_tracked,
    "commands-ended": _commands_ended,
    "interrupted": _interrupted,
    "old-command": _old_command,
    "poor-tracking": _poor_tracking,
    "wrong-height": _wrong_height,
}
