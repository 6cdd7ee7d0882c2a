"""What people change of an episode after it was recorded: success, tags, task; noted in its manifest, and undone."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from station.episode.storage.anchor import iso
from station.episode.storage.bin import expect_at_rest, move
from station.episode.storage.folder import slug
from station.episode.storage.manifest import Edit, Manifest, add_edit, save_manifest
from station.episode.storage.manifest_copy import find_manifest, manifest_to_change
from station.errors import EpisodeError, UsageError

MAX_TAGS = 50
_TAG = re.compile(r"\w[\w.:-]{0,39}")
_BIN = "bin"


def set_success(folder: Path, data: Path, success: bool | None, by: str) -> Edit | None:
    """Set whether the task was done; return the note, or None where it said so already.

    Raises:
        EpisodeError: it is not finished, or its manifest cannot be read or written.
    """
    return _change(folder, data, by, "success", lambda _: success)


def change_tags(folder: Path, data: Path, put: Collection[str], take: Collection[str], by: str) -> Edit | None:
    """Put tags on an episode and take tags off it; return the note, or None where nothing changed.

    Raises:
        UsageError: one of them is no tag, or there would be too many.
        EpisodeError: it is not finished, or its manifest cannot be read or written.
    """
    for tag in (*put, *take):
        if not _TAG.fullmatch(tag):
            raise UsageError(f"tag {tag!r}: expected 1 to 40 letters, digits, '_', '.', ':' or '-', not '-' first")

    def changed(before: list[str]) -> list[str]:
        after = sorted({*before, *put}.difference(take))
        if len(after) > MAX_TAGS:
            raise UsageError(f"{folder.name}: would have {len(after)} tags, {MAX_TAGS} are the most; take some off")
        return after

    return _change(folder, data, by, "tags", changed)


def rename_task(folder: Path, data: Path, task: str, by: str) -> Path:
    """Give an episode another task and move it to the folder of that; its id stays. Return where it is.

    Killed on the way, it has the new task and lies where it lay; the same call moves it then.

    Raises:
        EpisodeError: it is not finished, one of its id is there, or the disk refused it.
    """
    parent = data / slug(task)
    if folder.parent != parent and (parent / folder.name).exists():
        raise EpisodeError(f"{parent / folder.name}: is there already; move one of the two away")
    _change(folder, data, by, "task", lambda _: task)
    return folder if folder.parent == parent else move(folder, parent, data)


def note_bin(folder: Path, *, before: str, after: str, by: str) -> None:
    """Note in the manifest of an episode that it was moved into the bin, or back.

    Raises:
        EpisodeError: it cannot be read or written; the episode has been moved all the same.
    """
    manifest = _to_change(folder)
    add_edit(manifest, Edit(at=iso(time.time_ns()), by=by, what=_BIN, before=before, after=after))
    save_manifest(manifest, folder)


def undo(folder: Path, data: Path, by: str) -> tuple[Edit, Path]:
    """Undo the last change that still stands; return the note of it, and where the episode is.

    Raises:
        EpisodeError: there is none, or something else changed the same since; or as for the change itself.
    """
    manifest = find_manifest(folder).manifest
    last = next((edit for edit in reversed(manifest.edits) if edit.what != _BIN and not edit.undone), None)
    if last is None:
        raise EpisodeError(f"{folder.name}: nothing to undo: no change of it stands that was made with this station")

    def undone(now: Any) -> Any:
        if now != last.after:
            raise EpisodeError(
                f"{folder.name}: its {last.what} is {now!r} now, not {last.after!r} as {last.by} left it at {last.at}; "
                f"set what you want instead"
            )
        return last.before

    undone(_get(manifest, last.what))
    expect_at_rest(folder, data)
    parent = data / slug(str(last.before))
    if last.what == "task" and folder.parent != parent:  # first, so that a second call finds it still to be undone
        folder = move(folder, parent, data)
    _change(folder, data, by, last.what, undone, undoes=manifest.edits.index(last))
    return last, folder


def _change(
    folder: Path, data: Path, by: str, what: str, changed: Callable[[Any], Any], *, undoes: int | None = None
) -> Edit | None:
    expect_at_rest(folder, data)
    manifest = _to_change(folder)
    if manifest.state == "recording":
        raise EpisodeError(
            f"{folder.name}: not finished; stop the recording, or first: station episodes repair {folder.name}"
        )
    before = _get(manifest, what)
    after = changed(before)
    if after == before:
        return None
    _set(manifest, what, after)
    at = iso(time.time_ns())
    edit = Edit(at=at, by=by, what=what, before=before, after=after)
    if undoes is None:
        add_edit(manifest, edit)
    else:
        manifest.edits[undoes].undone = f"{at} by {by}"
    save_manifest(manifest, folder)
    return edit


def _to_change(folder: Path) -> Manifest:
    try:
        return manifest_to_change(folder)
    except OSError as error:
        raise EpisodeError(f"{folder}: cannot write the manifest: {error.strerror}") from error


def _get(manifest: Manifest, what: str) -> Any:
    values = {"success": manifest.quality_flags.success, "tags": list(manifest.tags), "task": manifest.task.name}
    return values[what]


def _set(manifest: Manifest, what: str, value: Any) -> None:
    if what == "success":
        manifest.quality_flags.success = value
    elif what == "tags":
        manifest.tags = value
    else:
        manifest.task.name = value
