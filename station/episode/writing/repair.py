"""Making a good episode of a torn one: every whole chunk kept, an index at its end, the original untouched."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Literal

import mcap.records
import msgspec

from station.episode.storage import layout
from station.episode.storage.anchor import Anchor, iso
from station.episode.storage.atomic import remove_leftovers, sync_folder
from station.episode.storage.disk import is_locked
from station.episode.storage.drops import Drops, drops_of, larger
from station.episode.storage.folder import signals_file
from station.episode.storage.left_open import is_left_open, manifest_of
from station.episode.storage.manifest import (
    Manifest,
    dump_manifest,
    load_manifest,
    note_recovery,
    parse_manifest,
    save_manifest,
)
from station.episode.storage.progress import ResumePoint, load_resume_point
from station.episode.storage.records import MAGIC, RawMessage, metadata_at_head, walk
from station.episode.writing.checkpoint import Told
from station.episode.writing.closing import close_manifest, summary_record
from station.episode.writing.retell import Retelling
from station.episode.writing.salvage import Salvaged, salvage
from station.episode.writing.signals import SignalsFile
from station.errors import EpisodeError

State = Literal["whole", "closed", "repaired"]


class Repaired(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one episode.

    Attributes:
        state: ``whole``: nothing to do; ``closed``: the file was whole, only its last words were missing; ``repaired``.
        episode_id, path: The episode, and the folder where it is good now.
        messages, seconds: What it holds, and how long it is from its start [s].
        cut_at, cut_bytes: Where the whole part ended, and how much of the file lay behind it.
        cut_messages: Messages known to have been in the file once and not kept; what never reached the disk, at most
            one flush interval, nobody counted.
        cut_s: From the last message kept to the last change of the torn file [s].
        original: Where the torn file is kept; "" when nothing was torn.
        requests: Ids of the requests to the recorder that it holds.
    """

    state: State
    episode_id: str
    path: str
    messages: int = 0
    seconds: float | None = None
    cut_at: int = 0
    cut_bytes: int = 0
    cut_messages: int = 0
    cut_s: float = 0.0
    original: str = ""
    requests: list[str] = []


def repair(folder: Path, *, out: Path | None = None) -> Repaired:
    """Make an episode good; one that is good stays as it is, so a second call changes nothing.

    Killed at any moment, it leaves the torn file as it was, and the next call does what is left to do.

    Args:
        folder: Folder of the episode.
        out: Folder in which the good episode's folder is made; None puts it beside the torn file.

    Raises:
        EpisodeError: it is being recorded, or cannot be read, or nothing of it can be saved, or the disk refused.
    """
    source = signals_file(folder)
    for file in (source, folder / layout.ACTIVE, folder / layout.REPAIRING):
        if file.exists() and is_locked(file):
            raise EpisodeError(f"{file}: is being written just now; stop the recording, then repair what is left open")
    try:
        may_close = out is None or not is_left_open(folder)  # closing in its own folder is no way to leave it alone
        if may_close and (done := close_whole(folder)) is not None:
            return done
        return _repair(folder, source, folder if out is None else out / folder.name)
    except OSError as error:
        raise EpisodeError(f"{folder}: cannot be repaired: {error.strerror} ({error.filename or source})") from error


def close_whole(folder: Path) -> Repaired | None:
    """Say the last words of an episode whose file is whole to its end; None when the file is not.

    Its recorder was killed between the last byte of the file and the last of the manifest, or not at all.

    Raises:
        EpisodeError: it is no episode of ours.
        OSError: the disk refused it.
    """
    file = signals_file(folder)
    if file.stat().st_size < len(MAGIC):
        return None
    contents = walk(file)
    if not contents.is_finished or contents.cut_at is not None or layout.MANIFEST not in contents.attachments:
        return None
    try:
        manifest = parse_manifest(contents.attachments[layout.MANIFEST], f"{file}, attachment {layout.MANIFEST}")
    except EpisodeError:
        return None
    anchor = manifest.timing.anchor
    if anchor is None:
        return None
    requests = Retelling(anchor)
    if not salvage(file, requests.take).is_finished:
        return None
    is_open = is_left_open(folder) or not _is_closed(folder, manifest)
    if is_open:
        _say_last_words(folder, file, manifest)
    return Repaired(
        state="closed" if is_open else "whole", episode_id=manifest.episode_id or folder.name, path=str(folder),
        messages=manifest.recorder.messages, seconds=manifest.timing.duration_s, requests=requests.told.requests,
    )  # fmt: skip


def _is_closed(folder: Path, inside: Manifest) -> bool:
    """Whether the manifest beside the file is no older than the one inside."""
    try:
        beside = load_manifest(folder)
    except EpisodeError:
        return False
    told, known = (len(one.recovery) + one.recovery_not_listed for one in (beside, inside))
    return beside.state != "recording" and told >= known


def _say_last_words(folder: Path, file: Path, manifest: Manifest) -> None:
    if file.name == layout.ACTIVE:
        file.rename(folder / layout.SIGNALS)
    sync_folder(folder)
    manifest.recorder.bytes = (folder / layout.SIGNALS).stat().st_size
    save_manifest(manifest, folder)
    if (folder / layout.ACTIVE).exists():  # a repair was killed before it had put the original aside
        (folder / layout.ACTIVE).rename(_free(folder / layout.TORN))
    _tidy(folder)


def _tidy(folder: Path) -> None:
    """Remove what only an unfinished episode has."""
    for name in (layout.RESUME, layout.CHECKPOINT):
        (folder / name).unlink(missing_ok=True)
    remove_leftovers(*(folder / name for name in (layout.MANIFEST, layout.RESUME, layout.CHECKPOINT)))


def _repair(folder: Path, source: Path, target: Path) -> Repaired:
    manifest, point = manifest_of(folder), load_resume_point(folder)
    anchor = _clock(source, manifest, point)
    target.mkdir(parents=True, exist_ok=True)
    copy = target / layout.REPAIRING
    copy.unlink(missing_ok=True)
    try:
        with copy.open("xb") as output:
            salvaged = salvage(source, _nothing, output=output)
        signals = _opened(copy, anchor, manifest, Drops(point.drops if point else ()))
        try:
            done = _close(source, salvaged, signals, anchor, manifest, point)
        finally:
            signals.close()
    except BaseException:
        copy.unlink(missing_ok=True)
        raise
    original = source
    if target != folder:
        copy.rename(target / layout.SIGNALS)
        save_manifest(manifest, target)
    else:
        original = _swap(source, copy, folder, manifest)
    return msgspec.structs.replace(done, path=str(target), original=str(original))


def _clock(source: Path, manifest: Manifest, point: ResumePoint | None) -> Anchor:
    """Return the clock of an episode: of its manifest, which is never half written, else of its file."""
    for anchor in (manifest.timing.anchor, point.anchor if point else None):
        if anchor is not None:
            return anchor
    try:
        return msgspec.convert(metadata_at_head(source, layout.ANCHOR_RECORD), Anchor, strict=False)
    except msgspec.ValidationError:
        raise EpisodeError(
            f"{source}: nothing tells its clock, neither file nor manifest; it cannot be saved"
        ) from None


def _opened(copy: Path, anchor: Anchor, manifest: Manifest, drops: Drops) -> SignalsFile:
    """Open what was saved; where not even its head was whole, with a head made from the manifest."""
    if copy.stat().st_size and layout.EPISODE_RECORD in (found := walk(copy).metadata):
        return SignalsFile.reopen(copy, anchor, drops=larger(drops, drops_of(found.get(layout.DROPPED_RECORD))))
    copy.unlink(missing_ok=True)
    facts = {"episode_id": manifest.episode_id, "task": manifest.task.name, "started": manifest.timing.started}
    return SignalsFile.create(copy, anchor, facts, dump_manifest(manifest))


def _close(
    source: Path, salvaged: Salvaged, signals: SignalsFile, anchor: Anchor, manifest: Manifest,
    point: ResumePoint | None,
) -> Repaired:  # fmt: skip
    """Close the file and its manifest, with a note of what was cut."""
    state, told = source.stat(), signals.retelling.told
    totals = signals.totals(dropped=max(signals.drops.total, point.dropped if point else 0, manifest.recorder.dropped))
    verdict = manifest.quality_flags if manifest.state == "finished" else None  # somebody may have discarded it since
    signals.retelling.apply(manifest, totals.first_ns)
    manifest.quality_flags = verdict or manifest.quality_flags
    _end(manifest, told, anchor, totals.last_ns)
    before = max(point.messages if point else 0, manifest.recorder.messages)
    done = Repaired(
        state="repaired", episode_id=manifest.episode_id or source.parent.name, path="", messages=totals.messages,
        seconds=manifest.timing.duration_s, cut_at=salvaged.kept_to,
        cut_bytes=0 if salvaged.is_finished else state.st_size - salvaged.kept_to,
        cut_messages=max(0, before - totals.messages), requests=told.requests,
        cut_s=round(max(0.0, (state.st_mtime_ns - totals.last_ns) * 1e-9), 3) if totals.last_ns else 0.0,
    )  # fmt: skip
    note = {
        "kind": "repaired",
        "at": iso(time.time_ns()),
        "kept_messages": done.messages,
        "cut_at": done.cut_at,
        "cut_bytes": done.cut_bytes,
        "cut_messages": done.cut_messages,
        "cut_s": done.cut_s,
    }
    note_recovery(manifest, note)
    manifest.quality = {}  # of the torn file
    close_manifest(manifest, anchor, totals)
    signals.finish(dump_manifest(manifest), summary_record(totals))
    manifest.recorder.bytes = signals.size
    return done


def _end(manifest: Manifest, told: Told, anchor: Anchor, last_ns: int) -> None:
    """Say when and why the episode ended: as its file says, else with its last message."""
    if told.ending is not None:
        manifest.recorder.ended_by = told.ending.action
    elif not manifest.recorder.ended_by:
        manifest.recorder.ended_by = "killed"
    ended_ns = max(last_ns, anchor.wall_ns)
    manifest.timing.ended = iso(ended_ns)
    manifest.timing.duration_s = round((ended_ns - anchor.wall_ns) * 1e-9, 6)


def _swap(source: Path, copy: Path, folder: Path, manifest: Manifest) -> Path:
    """Put the good file in its place and the torn one aside, so that one is always there; returns the latter."""
    aside = _free(folder / layout.TORN)
    if source.name == layout.ACTIVE:
        copy.rename(folder / layout.SIGNALS)
        save_manifest(manifest, folder)
        source.rename(aside)
    else:
        os.link(source, aside)
        copy.replace(source)
        save_manifest(manifest, folder)
    _tidy(folder)
    sync_folder(folder)
    return aside


def _free(path: Path) -> Path:
    """Return a path that does not exist: the given one, or with a number behind it."""
    number, free = 1, path
    while free.exists():
        number += 1
        free = path.with_name(f"{path.name}.{number}")
    return free


def _nothing(_message: RawMessage, _channel: mcap.records.Channel) -> None:
    """Take no note: the copy is read once more."""
