"""Another recorder's recording becomes an episode of ours: once, whole, and marked as what it is."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec

from station import registry
from station.atomic_file import sync_folder
from station.bus.tap import Write
from station.episode.quality.timing import IMPORTED
from station.episode.recorder.writer import EpisodeWriter
from station.episode.storage import layout
from station.episode.storage.anchor import Anchor, iso
from station.episode.storage.folder import slug
from station.episode.storage.manifest import Manifest, Operator, Recorder, Robot, Task, Timing, load_manifest
from station.episode.storage.manifest_copy import find_manifest
from station.episode.storage.named_lock import open_locked
from station.episode.storage.progress import Totals
from station.episode.writing.closing import close_manifest
from station.errors import EpisodeError, StationError
from station.foreign.kind import ForeignKind, ForeignWrite, Recording
from station.software import software

_NO_TIME_NS = 86_400 * 1_000_000_000  # 2 January 1970, which nobody takes for a time of a robot; 0 would mean "none"
_BATCH = 64  # writes, some of them pictures
_FULL, _ROOM_S = 0.25, 0.002  # of the queue, from half of which on pictures are dropped; and how often we look
_FINISH_S = 600.0  # a disk that takes so long to close a file is a broken one
_SHORT = 8  # hex digits of the hash in an id: two recordings of one task and number are told apart by them


class ImportJob(msgspec.Struct, frozen=True, kw_only=True):
    """One recording to be taken in.

    Attributes:
        format: Registered name of the format.
        path: The recording.
        data: The data folder, absolute.
        task: Name of the task; "" takes the recorder's own.
        instruction: The task in words.
    """

    format: str
    path: str
    data: str
    task: str = ""
    instruction: str = ""


class ImportResult(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one recording.

    Attributes:
        path: Folder of the episode.
        is_new: False where it was there already.
        messages, seconds, size_bytes: What is in it.
        are_times_measured: Whether its times are its recorder's own; else they are places in a list.
        odd: What looks wrong in it.
    """

    path: str
    is_new: bool
    messages: int
    seconds: float
    size_bytes: int
    are_times_measured: bool
    odd: list[str] = []


def import_recording(order: ImportJob) -> ImportResult:
    """Make an episode of a recording; one that is there already stays as it is.

    Killed at any moment, it leaves nothing that could be taken for an episode; the next call does it anew. Several
    processes that are given the same recording make one episode of it.

    Raises:
        BadFile: the recording is not of this format, or something in it is wrong.
        EpisodeError: the episode cannot be written.
    """
    kind: ForeignKind = registry.find("foreign", order.format)
    recording = kind.read(Path(order.path))
    data, task = Path(order.data), order.task or recording.task
    name = f"{kind.name}-{slug(task)}-{slug(recording.number)}-{recording.sha256[:_SHORT]}"
    there = _there(data, kind, recording)
    if there is not None:
        return _told(there, recording, is_new=False)
    folder, making = data / slug(task) / name, data / f".importing-{kind.name}-{recording.sha256[:_SHORT]}"
    try:
        with claimed(making):
            there = _there(data, kind, recording)  # of another process, since we looked
            if there is not None:
                return _told(there, recording, is_new=False)
            making.mkdir()
            _write(making, _manifest(kind, recording, order, name, task), recording)
            folder.parent.mkdir(exist_ok=True)
            making.rename(folder)
            sync_folder(folder.parent)
    except OSError as error:
        if error.filename is None:
            raise EpisodeError(f"{folder}: cannot be written: {error.strerror}") from error
        raise
    return _told(folder, recording, is_new=True)


def _there(data: Path, kind: ForeignKind, recording: Recording) -> Path | None:
    """Return the episode that was made of the same recording before, whatever its task is called."""
    for folder in sorted(data.glob(f"*/{kind.name}-*-{recording.sha256[:_SHORT]}")):
        try:
            found = find_manifest(folder).manifest.foreign.get(IMPORTED)
        except EpisodeError:
            continue
        if isinstance(found, dict) and found.get("sha256") == recording.sha256:
            return folder
    return None


def _manifest(kind: ForeignKind, recording: Recording, order: ImportJob, name: str, task: str) -> Manifest:
    times = recording.times
    anchor = Anchor(wall_ns=times.started_ns or _NO_TIME_NS, mono_ns=0, boot="")
    how = "" if times.source == "measured" else f", times not measured: {times.rate_hz:g} Hz is nominal"
    imported: dict[str, Any] = {
        "format": kind.name,
        "recorder": kind.recorder,
        "source": recording.path.name,
        "sha256": recording.sha256,
        "at": iso(time.time_ns()),
        "times": {"source": times.source, "note": times.note, "rate_hz": times.rate_hz},
        "unknown": list(recording.unknown),
        "odd": list(recording.odd),
        "facts": recording.facts,
    }
    return Manifest(
        episode_id=name,
        task=Task(name=task, instruction=order.instruction),
        operator=Operator(id=recording.operator),
        robot=Robot(suffix=recording.robot),
        cameras=list(recording.cameras),
        timing=Timing(
            started="" if times.started_ns is None else iso(times.started_ns),
            ended="" if times.started_ns is None else iso(times.started_ns + recording.length_ns),
            anchor=anchor,
            duration_s=round(recording.length_ns * 1e-9, 6),
        ),
        recorder=Recorder(
            backend=f"{kind.recorder}{how}",
            software=msgspec.to_builtins(software()),
            ended_by="imported",
            is_lossless=False,
        ),
        foreign={IMPORTED: imported},
    )


def _write(folder: Path, manifest: Manifest, recording: Recording) -> None:
    """Write the episode's files.

    Raises:
        BadFile: the recording.
        EpisodeError: the disk.
    """
    anchor = manifest.timing.anchor
    assert anchor is not None
    writer = EpisodeWriter(folder, anchor=anchor, manifest=manifest)

    def closing(totals: Totals) -> Manifest:
        close_manifest(manifest, anchor, totals)
        return manifest

    try:
        _feed(writer, recording.writes())
    finally:  # its thread ends before the folder goes
        writer.finish(closing)
        is_over = writer.wait(_FINISH_S)
    if writer.error or not is_over:
        raise EpisodeError(f"{folder}: {writer.error or 'the disk does not take it'}")


def _feed(writer: EpisodeWriter, writes: Iterator[ForeignWrite]) -> None:
    """Give the writer what its queue has room for: a file can wait where a bus cannot."""
    while batch := [Write(key, value, None, at_ns) for key, value, at_ns in islice(writes, _BATCH)]:
        while writer.load > _FULL and writer.state != "failed":
            time.sleep(_ROOM_S)
        dropped = writer.put(batch, is_live=False)
        if writer.state == "failed":
            return
        if dropped:
            raise StationError(f"{writer.folder}: the queue before the disk has no room for {len(batch)} writes")


def _told(folder: Path, recording: Recording, *, is_new: bool) -> ImportResult:
    manifest = load_manifest(folder)
    return ImportResult(
        path=str(folder),
        is_new=is_new,
        messages=manifest.recorder.messages,
        seconds=manifest.timing.duration_s or 0.0,
        size_bytes=sum(file.stat().st_size for file in folder.glob(f"*{Path(layout.SIGNALS).suffix}")),
        are_times_measured=recording.times.source == "measured",
        odd=list(recording.odd),
    )


@contextlib.contextmanager
def claimed(making: Path) -> Iterator[None]:
    """Claim the place of a folder that is to be made, waiting while another process has it.

    Nothing is there when it is claimed, nor afterwards: what a process made and did not rename is removed, also where
    it was killed. A file beside it, ``NAME.lock``, is there as long as it is claimed.

    Raises:
        OSError: nothing can be made there.
    """
    with contextlib.suppress(FileExistsError):  # a file stands there, and the lock cannot be made
        making.parent.mkdir(parents=True, exist_ok=True)
    lock = making.with_name(f"{making.name}.lock")
    with open_locked(lock, waits=True):
        try:
            shutil.rmtree(making, ignore_errors=True)  # of a process that was killed
            yield
        finally:
            shutil.rmtree(making, ignore_errors=True)
            lock.unlink(missing_ok=True)  # last: from now on others make theirs
