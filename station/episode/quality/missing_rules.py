"""The rules about what is not in the file though it was on the bus, or should have been there."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from station.bus import keys
from station.episode.quality.finding_parts import KeyChanges, KeyPresence, Loss
from station.episode.quality.findings import Quality, Verdict
from station.episode.quality.rule_file import Ends, Limits
from station.episode.quality.sensed_rules import GAP_PERIODS, Finder

_NAMED = 5  # keys of a finding that are listed
_DESCRIBED = ("command", "state", "policy", "sensor")
_OF_THE_ROBOT = ("state", "policy")
_ANY_HZ = 1e9
_SHORTEST_S = 1e-3  # of an episode; keeps a share finite


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
    for camera in quality.cameras:
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
        others = f"; so or less of {len(group) - 1} other keys of it" if len(group) > 1 else ""
        text = f"{worst.key} by {worst.writer}: {what} {missing_s(worst):.1f} s ({share:.0%} of the episode){others}"
        yield verdict, text


def _writer_gap(quality: Quality, limits: Limits) -> Iterator[tuple[Verdict, str]]:
    found = [one for one in _of_streams(quality) if one.role in _OF_THE_ROBOT]
    worst = max(found, key=lambda one: one.between_s, default=None)
    if worst is not None and worst.between_s > limits.writer_gap.usable_above_s:
        verdict: Verdict = "reject" if worst.between_s > limits.writer_gap.reject_above_s else "usable"
        yield verdict, f"{worst.key}: silent for {worst.between_s:.2f} s until another process wrote it"


def _server_died(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for server, losses in _by_server(one for one in quality.losses if one.kind != "camera-lost").items():
        verdict: Verdict = "reject" if losses[0].role == "low-level" else "usable"
        yield verdict, f"server {server} at {losses[0].at_s:.2f} s: {losses[0].kind}, {losses[0].reason}{_more(losses)}"


def _camera_lost(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for server, losses in _by_server(one for one in quality.losses if one.kind == "camera-lost").items():
        yield "usable", f"camera {server} lost at {losses[0].at_s:.2f} s: {losses[0].reason}{_more(losses)}"


def _no_pictures(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    for key in quality.no_pictures:
        yield (
            "reject",
            f"camera {key.removeprefix(keys.camera_image(''))}: its server lived, and there is no picture of it",
        )


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


MISSING: dict[str, Finder] = {
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
}
"""Those rules by the name that a reason carries."""
