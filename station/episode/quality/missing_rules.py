"""The rules about what is not in the file though it was on the bus, or should have been there."""

from __future__ import annotations

from collections.abc import Iterator

from station.episode.quality.changes import role_of
from station.episode.quality.finding_parts import KeyChanges
from station.episode.quality.findings import Quality, Verdict
from station.episode.quality.rule_file import Limits
from station.episode.quality.sensed_rules import Finder

_NAMED = 5  # keys of a finding that are listed
_OF_THE_ROBOT = ("command", "state", "policy", "sensor")


def _not_mirrored(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    known = [one for one in quality.not_mirrored if not one.key or role_of(one.key) is not None]
    others = [one for one in quality.not_mirrored if one.key and role_of(one.key) is None]
    graded: list[tuple[Verdict, list[KeyChanges]]] = [("reject", known), ("usable", others)]
    for verdict, found in graded:
        if found:
            count, first = sum(one.count for one in found), min(one.at_s for one in found)
            what = _listed([f"{one.key or 'an unknown key'} by {one.command} {one.count}" for one in found])
            yield verdict, f"{count} write(s) on the bus are not in the file, the first at {first:.2f} s: {what}"


def _deleted(quality: Quality, _: Limits) -> Iterator[tuple[Verdict, str]]:
    found = [one for one in quality.deletions if role_of(one.key) in _OF_THE_ROBOT]
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
    "not-mirrored": _not_mirrored,
    "deleted": _deleted,
}
"""Those rules by the name that a reason carries."""
