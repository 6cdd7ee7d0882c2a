"""The copy of the manifest inside the file of signals: it serves where the one beside it cannot be read."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from station.atomic_file import free_path
from station.episode.storage import layout
from station.episode.storage.manifest import LaterManifest, Manifest, load_manifest, parse_manifest
from station.episode.storage.records import walk
from station.errors import EpisodeError

log = logging.getLogger(__name__)

_MAY_CHANGE = frozenset({
    "manifest_version", "state", "files", "recorder.bytes",  # known only once the copy is written
    "quality_flags", "marks", "quality", "recovery", "recovery_not_listed",  # what people and programs say of it later
    "foreign", "shortened", "tags", "edits", "edits_not_listed", "compacted",
})  # fmt: skip
_DEEPEST = 3  # parts of a name
_MOST_FIELDS = 50


class FoundManifest(NamedTuple):
    """A manifest, and a line that says why the one in the folder is not it; "" where it is, or where none is there."""

    manifest: Manifest
    problem: str


def find_manifest(folder: Path) -> FoundManifest:
    """Return the manifest of an episode: the one in its folder, else the newest copy inside its signals.

    Raises:
        EpisodeError: neither can be read; says what is wrong with the first.
    """
    for name in (layout.SIGNALS, layout.ACTIVE, layout.TORN):
        if (folder / name).is_file():
            return choose_manifest(folder, folder / name)
    return FoundManifest(load_manifest(folder), "")


def choose_manifest(folder: Path, signals: Path, attachments: Mapping[str, bytes] | None = None) -> FoundManifest:
    """Do the same for a known file of signals; its attachments are read only if need be, unless they are given.

    Raises:
        EpisodeError: likewise.
    """
    file = folder / layout.MANIFEST
    try:
        return FoundManifest(load_manifest(file), "")
    except LaterManifest:
        raise
    except EpisodeError as error:
        found = walk(signals).attachments if attachments is None else attachments
        name = next((name for name in (layout.MANIFEST, layout.MANIFEST_START) if name in found), None)
        if name is None:
            raise
        copy = parse_manifest(found[name], f"{signals}, attachment {name}")
        if not file.exists():
            return FoundManifest(copy, "")
        return FoundManifest(copy, f"{error}; the copy inside {signals.name} serves, without what was changed later")


def changed_fields(manifest: Manifest, attachments: Mapping[str, bytes]) -> list[str]:
    """Return which fields of a manifest are not what the recording says of itself, of those that nothing may change.

    Args:
        manifest: The one beside the files.
        attachments: Those of the signals; the copy of before the first write is not compared.
    """
    inside = attachments.get(layout.MANIFEST)
    if inside is None:
        return []
    try:
        copy = parse_manifest(inside, f"attachment {layout.MANIFEST}")
    except EpisodeError:
        return []  # nothing can be said; one of a later station has other fields
    if copy.state == "recording":  # of an earlier station, never closed
        return []
    cut = {*manifest.shortened, *copy.shortened}  # what did not fit into either says nothing
    said, now = (_facts(one, cut) for one in (copy, manifest))
    if "task" in now and _is_renamed(manifest, copy.task.name):
        now["task"] |= {"name": copy.task.name}
    return list(_differing(said, now, ""))[:_MOST_FIELDS]


def _is_renamed(manifest: Manifest, name: str) -> bool:
    """Whether its task has another name than the one given because people said so, by the notes of what they changed.

    Where the oldest notes are not listed, nothing says what the first name was.
    """
    for edit in manifest.edits:
        if edit.what == "task" and not edit.undone:
            if edit.before != name and not manifest.edits_not_listed:
                return False
            name = edit.after
    return name == manifest.task.name


def _facts(manifest: Manifest, cut: set[str]) -> dict[str, Any]:
    return {
        name: msgspec.to_builtins(getattr(manifest, name))
        for name in manifest.__struct_fields__
        if name not in _MAY_CHANGE and name not in cut
    }


def _differing(said: Mapping[Any, Any], now: Mapping[Any, Any], inside: str) -> Iterator[str]:
    """Iterate over the names of what differs, as deep as that is a mapping."""
    for key in dict.fromkeys((*said, *now)):
        name = f"{inside}{key}"
        one, other = said.get(key), now.get(key)
        if name in _MAY_CHANGE or one == other:
            continue
        if isinstance(one, Mapping) and isinstance(other, Mapping) and name.count(".") < _DEEPEST:
            yield from _differing(one, other, f"{name}.")
        elif repr(one) != repr(other):  # no number is not equal to itself
            yield name


def manifest_to_change(folder: Path) -> Manifest:
    """Return the manifest of an episode to be saved anew; one that cannot be read is put aside first.

    Raises:
        EpisodeError: there is none that can be read.
        OSError: the disk refused it.
    """
    manifest, problem = find_manifest(folder)
    if problem:
        aside = (folder / layout.MANIFEST).rename(free_path(folder / f"{layout.MANIFEST}.broken"))
        log.warning("%s: cannot be read, and is written anew; the unreadable one is kept as %s", folder, aside.name)
    return manifest
