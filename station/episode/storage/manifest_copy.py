"""The copy of the manifest inside the file of signals: it serves where the one beside it cannot be read."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from station.atomic_file import free_path
from station.episode.storage import layout
from station.episode.storage.manifest import LaterManifest, Manifest, load_manifest, parse_manifest
from station.episode.storage.records import walk
from station.errors import EpisodeError

log = logging.getLogger(__name__)


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
        inside = found.get(layout.MANIFEST)
        if inside is None:
            raise
        copy = parse_manifest(inside, f"{signals}, attachment {layout.MANIFEST}")
        if not file.exists():
            return FoundManifest(copy, "")
        return FoundManifest(copy, f"{error}; the copy inside {signals.name} serves, without what was changed later")


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
