"""Making a good episode of a torn or damaged one: every whole chunk kept, an index at its end, the original untouched.

What is damaged between whole chunks is left out; the manifest calls it a hole.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple

import mcap.records
import msgspec

from station.atomic_file import free_path, sync_folder
from station.episode.storage import layout
from station.episode.storage.anchor import Anchor, iso
from station.episode.storage.claim import is_claimed
from station.episode.storage.drops import Drops, drops_of, larger
from station.episode.storage.file_hashes import changes
from station.episode.storage.folder import signals_file
from station.episode.storage.left_open import is_left_open, not_begun, remove_not_begun, remove_temporary
from station.episode.storage.manifest import (
    Hole,
    Manifest,
    add_hole,
    add_recovery,
    dump_manifest,
    facts_of,
    load_manifest,
    parse_manifest,
    save_manifest,
)
from station.episode.storage.manifest_copy import find_manifest, manifest_to_change
from station.episode.storage.progress import ResumePoint, load_resume_point
from station.episode.storage.records import MAGIC, RawMessage, metadata_at_head, walk
from station.episode.writing.checkpoint import SummaryState
from station.episode.writing.closing import close_manifest, note_files, summary_record
from station.episode.writing.file import EpisodeFile, head_of
from station.episode.writing.files import EpisodeFiles
from station.episode.writing.salvage import Damage, Head, SalvageResult, salvage
from station.episode.writing.summary import EpisodeSummary
from station.errors import EpisodeError
from station.lock_file import is_locked

State = Literal["whole", "closed", "repaired"]


class Repaired(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one episode.

    Attributes:
        state: ``whole``: nothing to do; ``closed``: the files were whole, only the last words were missing;
            ``repaired``.
        episode_id, path: The episode, and the folder where it is good now.
        messages, seconds: What it holds, and how long it is from its start [s].
        cut_messages: Messages known to have been in the files once and not kept; what never reached the disk, at most
            one flush interval, are not counted.
        cuts: What was cut, of each file that was torn.
        requests: Ids of the requests to the recorder that it holds.
    """

    state: State
    episode_id: str
    path: str
    messages: int = 0
    seconds: float | None = None
    cut_messages: int = 0
    cuts: list[Cut] = []
    requests: list[str] = []


def repair(folder: Path, *, out: Path | None = None) -> Repaired:
    """Make an episode good; one that is good stays as it is, so a second call changes nothing.

    Killed at any moment, it leaves the torn files as they were, and the next call does what is left to do.

    Args:
        folder: Folder of the episode.
        out: Folder in which the good episode's folder is made; None puts it beside the torn files.

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
        return _repair(folder, folder if out is None else out / folder.name)
    except OSError as error:
        raise EpisodeError(f"{folder}: cannot be repaired: {error.strerror} ({error.filename or source})") from error


def remove_what_never_began(data: Path) -> None:
    """Remove the folders of episodes of which there is nothing, unless a recorder is at work that may begin them."""
    if not is_claimed(data):
        for folder in not_begun(data):
            remove_not_begun(folder)


def close_whole(folder: Path) -> Repaired | None:
    """Finish an episode whose files are whole to their ends; None when they are not.

    Its recorder was killed between the last byte of the files and the last of the manifest, or not at all.

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
    requests = EpisodeSummary(anchor)
    if not salvage(file, requests.on_message).is_finished or not all(
        _is_whole(folder, names, manifest) for names in layout.BULK_NAMES
    ):
        return None
    is_open = is_left_open(folder) or not _is_closed(folder, manifest)
    if is_open:
        _finish_repair(folder, manifest)
    return Repaired(
        state="closed" if is_open else "whole", episode_id=manifest.episode_id or folder.name, path=str(folder),
        messages=manifest.recorder.messages, seconds=manifest.timing.duration_s, requests=requests.told.requests,
    )  # fmt: skip


def _is_whole(folder: Path, names: layout.Names, manifest: Manifest) -> bool:
    """Whether the file of pictures or clouds lacks nothing, or is not there because there were none."""
    if (file := _present(folder, names.final, names.active)) is None:
        return not any(stream.count for stream in manifest.streams if stream.file == names.final)
    return scan(file, names).is_finished


def _is_closed(folder: Path, inside: Manifest) -> bool:
    """Whether the manifest beside the file is no older than the one inside."""
    try:
        beside = load_manifest(folder)
    except EpisodeError:
        return False
    told, known = (len(one.recovery) + one.recovery_not_listed for one in (beside, inside))
    return beside.state != "recording" and told >= known


def _finish_repair(folder: Path, manifest: Manifest) -> None:
    for names in reversed(layout.ALL_NAMES):
        if (folder / names.active).exists() and not (folder / names.final).exists():
            (folder / names.active).rename(folder / names.final)
    sync_folder(folder)
    _save_final(folder, manifest)
    _put_aside(folder)  # a repair was killed before it had done that
    _tidy(folder)


def _save_final(folder: Path, manifest: Manifest) -> None:
    if (folder / layout.MANIFEST).exists():
        manifest_to_change(folder)  # one that cannot be read is kept beside the new one
    before = manifest.files
    note: dict[str, Any] = manifest.recovery[-1] if manifest.recovery else {}
    note_files(manifest, folder)
    changed = [msgspec.structs.asdict(change) for change in changes(before, manifest.files)]
    if changed and note.get("kind") == "repaired":
        note["changed"] = changed  # a repair may: the files have other hashes now, and it says so
    save_manifest(manifest, folder)


def _put_aside(folder: Path) -> dict[str, Path]:
    """Put aside what is torn, the signals last, by which all see that an episode is not closed; return where to."""
    aside = {}
    for names in reversed(layout.ALL_NAMES):
        if (folder / names.active).exists():
            aside[names.final] = (folder / names.active).rename(free_path(folder / names.torn))
    return aside


def _tidy(folder: Path) -> None:
    """Remove what only an unfinished episode has; last that by which all see that something is left to do."""
    remove_temporary(folder)
    for name in (layout.CHECKPOINT, layout.RESUME):
        (folder / name).unlink(missing_ok=True)


def _repair(folder: Path, target: Path) -> Repaired:
    manifest, point = find_manifest(folder).manifest, load_resume_point(folder)
    # The unfinished file comes first: where both are there, a repair that was killed has made the other one of it.
    found = [(names, _present(folder, names.active, names.final)) for names in layout.ALL_NAMES]
    sources = [(names, source) for names, source in found if source is not None]
    anchor, drops = _clock(sources[0][1], manifest, point), Drops(point.drops if point else ())
    target.mkdir(parents=True, exist_ok=True)
    mended: list[RepairedFile] = []
    try:
        for names, source in sources:
            mended.append(mend(source, target / names.repairing, names, anchor, manifest, drops))
        done = _close(mended, anchor, manifest, point)
    except BaseException:
        for names in layout.ALL_NAMES:
            (target / names.repairing).unlink(missing_ok=True)
        raise
    finally:
        for one in reversed(mended):
            if one.file is not None:
                one.file.close()
    originals = _swap(mended, folder, manifest) if target == folder else _place(mended, target, manifest)
    cuts = [msgspec.structs.replace(cut, original=str(originals[cut.file])) for cut in done.cuts]
    return msgspec.structs.replace(done, path=str(target), cuts=cuts)


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


def _close(mended: Sequence[RepairedFile], anchor: Anchor, manifest: Manifest, point: ResumePoint | None) -> Repaired:
    """Close the files and their manifest, with a note of what was cut."""
    files = EpisodeFiles(mended[0].source.parent, anchor, {}, *(one.file for one in mended if one.file is not None))
    told, cuts = files.signals.episode_summary.told, [cut for one in mended for cut in one.cuts(anchor)]
    totals = files.totals(dropped=max(files.drops.total, point.dropped if point else 0, manifest.recorder.dropped))
    verdict = manifest.quality_flags if manifest.state == "finished" else None  # somebody may have discarded it since
    files.signals.episode_summary.apply(manifest, totals.first_ns)
    for cut in cuts:
        if cut.from_s is not None:
            to_s = manifest.timing.duration_s if cut.to_s is None else cut.to_s
            add_hole(manifest, Hole(from_s=cut.from_s, to_s=to_s, reason=f"{cut.file} was damaged at byte {cut.at}"))
    manifest.holes.sort(key=lambda hole: hole.from_s)
    manifest.quality_flags = verdict or manifest.quality_flags
    _end(manifest, told, anchor, totals.last_ns)
    before = max(point.messages if point else 0, manifest.recorder.messages)
    done = Repaired(
        state="repaired", episode_id=manifest.episode_id or mended[0].source.parent.name, path="",
        messages=totals.messages, seconds=manifest.timing.duration_s, requests=told.requests,
        cut_messages=max(0, before - totals.messages), cuts=cuts,
    )  # fmt: skip
    note = {
        "kind": "repaired",
        "at": iso(time.time_ns()),
        "kept_messages": done.messages,
        "cut_messages": done.cut_messages,
        "cuts": [_note_of(cut) for cut in cuts],
    }
    add_recovery(manifest, note)
    manifest.quality = {}  # of the torn files
    close_manifest(manifest, anchor, totals)
    files.finish(dump_manifest(manifest), summary_record(totals))
    return done


def _note_of(cut: Cut) -> dict[str, Any]:
    """Return what a manifest says of a cut: where in the file, and when where that is known."""
    times = {} if cut.from_s is None else {"from_s": cut.from_s, "to_s": cut.to_s}
    return {"file": cut.file, "at": cut.at, "bytes": cut.bytes, **times}


def _end(manifest: Manifest, told: SummaryState, anchor: Anchor, last_ns: int) -> None:
    """Put into the manifest when and why the episode ended: as its file says, else with its last message."""
    if told.ending is not None:
        manifest.recorder.ended_by = told.ending.action
    elif not manifest.recorder.ended_by:
        manifest.recorder.ended_by = "killed"
    ended_ns = max(last_ns, anchor.wall_ns)
    manifest.timing.ended = iso(ended_ns)
    manifest.timing.duration_s = round((ended_ns - anchor.wall_ns) * 1e-9, 6)


def _swap(mended: Sequence[RepairedFile], folder: Path, manifest: Manifest) -> dict[str, Path]:
    """Put the good files in their places and the torn ones aside, so that one is always there; returns the latter."""
    aside = {}
    for names, source, salvaged, file in mended:
        copy, final = folder / names.repairing, folder / names.final
        if (
            salvaged.is_finished and names is not layout.SIGNALS_NAMES
        ):  # the signals get another manifest, pictures nothing
            copy.unlink(missing_ok=True)
            source.rename(final)
            continue
        if source == final and not salvaged.is_finished:
            aside[names.final] = free_path(folder / names.torn)
            os.link(source, aside[names.final])
        if file is not None:
            copy.replace(final)
        elif source == final:
            source.unlink()
    _save_final(folder, manifest)
    aside |= _put_aside(folder)
    _tidy(folder)
    sync_folder(folder)
    return aside


def _place(mended: Sequence[RepairedFile], target: Path, manifest: Manifest) -> dict[str, Path]:
    """Put the good files into a folder of their own; returns the originals."""
    for names, _, _, file in mended:
        if file is not None:
            (target / names.repairing).rename(target / names.final)
    _save_final(target, manifest)
    return {one.names.final: one.source for one in mended}


def _present(folder: Path, *names: str) -> Path | None:
    """Return the first of some files of a folder that is there."""
    return next((folder / name for name in names if (folder / name).exists()), None)


class Cut(msgspec.Struct, frozen=True, kw_only=True):
    """What was cut of one file.

    Attributes:
        file: Name of the file that is good now.
        at, bytes: Where the whole part ended, and how much of the file was cut there.
        original: Where the torn file is kept.
        from_s, to_s: Of what was cut out between other messages: from the last one before it to the first one behind it
            [s from the start]. None for the end of a file that was cut off, and where no message was in it; `to_s` None
            where no message follows.
    """

    file: str
    at: int
    bytes: int
    original: str = ""
    from_s: float | None = None
    to_s: float | None = None


class RepairedFile(NamedTuple):
    """A file that was torn, or was not.

    Attributes:
        names: What it is called.
        source: The original, which nothing changes.
        salvaged: What is whole of it.
        file: The copy, open at its end; None where nothing was worth a copy.
    """

    names: layout.Names
    source: Path
    salvaged: SalvageResult
    file: EpisodeFile | None

    @property
    def is_whole(self) -> bool:
        """Whether the original lacks nothing."""
        return self.salvaged.is_finished

    def cuts(self, anchor: Anchor) -> list[Cut]:
        """Return what was cut: out of its middle, and at its end."""

        found = [
            Cut(file=self.names.final, at=one.at, bytes=one.bytes, from_s=from_s, to_s=to_s)
            for one in self.salvaged.damages
            for from_s, to_s in [_span(one, anchor)]
        ]
        if not self.salvaged.has_end:
            at = self.salvaged.kept_to
            found.append(Cut(file=self.names.final, at=at, bytes=self.source.stat().st_size - at))
        return found


def _span(damage: Damage, anchor: Anchor) -> tuple[float | None, float | None]:
    """Return from when to when a damage reaches [s from the start], as `Cut` has it; of no time without messages."""
    if not damage.had_messages:
        return None, None
    to_s = None if damage.to_ns is None else round((damage.to_ns - anchor.wall_ns) * 1e-9, 6)
    if damage.from_ns is None:  # it began before the start where the first message behind it did
        return min(0.0, to_s or 0.0), to_s
    return round((damage.from_ns - anchor.wall_ns) * 1e-9, 6), to_s


def mend(
    source: Path, copy: Path, names: layout.Names, anchor: Anchor, manifest: Manifest, drops: Drops
) -> RepairedFile:
    """Copy what is whole of a file, and open the copy.

    Args:
        source: The file.
        copy: Where to; what is there is overwritten.
        names: What it is called.
        anchor, manifest: Clock and manifest of its episode, of which a head is made where that was not whole.
        drops: What is known to have been dropped.

    Raises:
        OSError: the disk refused it.
        EpisodeError: it is no MCAP file, or damaged in a way that nothing of it can be used.
    """
    copy.unlink(missing_ok=True)
    with copy.open("xb") as output:
        salvaged = scan(source, names, output, head_of(anchor, facts_of(manifest)))
    opened = _opened(copy, names, anchor, manifest, drops)
    if names is not layout.SIGNALS_NAMES and opened is not None and not opened.messages:
        opened.close()
        opened = None
    if opened is None:
        copy.unlink(missing_ok=True)
    return RepairedFile(names, source, salvaged, opened)


def _opened(copy: Path, names: layout.Names, anchor: Anchor, manifest: Manifest, drops: Drops) -> EpisodeFile | None:
    """Open what was saved; where not even the head of the signals was whole, with one made from the manifest."""
    if copy.stat().st_size and layout.EPISODE_RECORD in (found := walk(copy).metadata):
        known = larger(drops, drops_of(found.get(layout.DROPPED_RECORD)))
        return EpisodeFile.reopen(copy, anchor, names=names, drops=known)
    if names is not layout.SIGNALS_NAMES:
        return None
    copy.unlink(missing_ok=True)
    return EpisodeFile.create(copy, anchor, facts_of(manifest), manifest=dump_manifest(manifest))


def scan(
    source: Path, names: layout.Names, output: BinaryIO | None = None, head: Head | None = None
) -> SalvageResult:  # fmt: skip
    """Go through a file for its wholeness, or have what is whole copied behind a head.

    Nothing is whole of pictures or clouds that are no MCAP file at all.

    Raises:
        OSError: it cannot be read, or its copy not written.
        EpisodeError: it is that of the signals, and no MCAP file.
    """
    try:
        return salvage(source, _ignore, output=output, head=head)
    except EpisodeError:
        if names is layout.SIGNALS_NAMES:
            raise
        return SalvageResult({}, {}, 0, b"", is_finished=False)  # the signals are worth saving all the same


def _ignore(_message: RawMessage, _channel: mcap.records.Channel) -> None:
    pass
