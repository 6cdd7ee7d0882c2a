"""Compacting an episode: its JPEG pictures become H.264, once every one of them was read back and compared.

Depth stays as it was recorded, byte for byte, which is compared too.

The new file is made beside the old one, read back, and takes its name in one rename. What the manifest then says of it
stands in the new file too, so that a process killed between the rename and the manifest loses nothing: the next call
writes the manifest.
"""

from __future__ import annotations

import shutil
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from itertools import zip_longest
from pathlib import Path
from typing import BinaryIO, Literal

import msgspec
import numpy as np

from station.episode.compacting.video_file import Unfit, VideoFile, becomes_video
from station.episode.reading.messages import Message
from station.episode.reading.part import Part
from station.episode.reading.reader import EpisodeReader
from station.episode.storage import layout, pictures
from station.episode.storage.anchor import iso
from station.episode.storage.bin import expect_at_rest
from station.episode.storage.file_hashes import changes, measure, words
from station.episode.storage.folder import signals_file
from station.episode.storage.manifest import Compacted, Manifest, RecordedFile, save_manifest
from station.episode.storage.manifest_copy import manifest_to_change
from station.episode.storage.manifest_parts import CompactedCamera
from station.episode.storage.whole_file import part_of, whole_file
from station.episode.writing.closing import note_files
from station.episode.writing.file import STAMPS_NUMBER
from station.errors import EpisodeError
from station.software import software
from station.video import X264, JpegDecoder, in_planes, planes, psnr_db

LEAST_DB = 35.0
"""Mean PSNR of a camera below which its episode is left as it is [dB]."""

_ROOM = 4  # the new file is smaller by more than this, or it is not worth its loss
_TELL_EVERY = 50  # messages
_NOTE = "manifest"  # in the record of the file

Progress = Callable[[int, int], None]
"""Called with messages done and messages in all; each counts twice, when it is written and when it is compared."""


class CompactResult(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one episode.

    Attributes:
        state: ``compacted``; ``current``: it was already; ``no-pictures``: it has none; ``left``: as it was.
        episode_id, path: The episode, and its folder.
        why: It was left as it was, in a line.
        bytes_before, bytes_after: Size of the file of pictures.
        pictures: How many, each of them compared with its JPEG file.
        kept: Keys of depth, whose pictures stay as they are.
        psnr_db, psnr_worst_db: Of the camera with the lowest mean, and of the worst picture [dB].
        seconds: How long it took [s].
    """

    state: Literal["compacted", "current", "no-pictures", "left"]
    episode_id: str
    path: str
    why: str = ""
    bytes_before: int = 0
    bytes_after: int = 0
    pictures: int = 0
    kept: list[str] = []
    psnr_db: float | None = None
    psnr_worst_db: float | None = None
    seconds: float = 0.0


def compact(
    folder: Path, data: Path, *, crf: int = 24, gop: int = 30, dry_run: bool = False,
    progress: Progress | None = None,
) -> CompactResult:  # fmt: skip
    """Make the pictures of an episode H.264, and its JPEG files go; killed at any moment, it has the ones or the other.

    Args:
        folder: The episode.
        data: Its data folder.
        crf: x264's constant rate factor: the lower, the better and larger.
        gop: A key frame at least every so many pictures of each camera; a file's chunks begin with them.
        dry_run: Only say whether it would be done.
        progress: Told how far it is.

    Raises:
        EpisodeError: it is being written, was never finished, is damaged or changed, or there is no room.
        OSError: the disk refused it.
    """
    began = time.perf_counter()
    expect_at_rest(folder, data)
    reader = EpisodeReader(signals_file(folder))
    _expect_whole(reader)
    every = [channel for part in reader.parts[1:] for channel in part.channels() or ()]
    channels = [channel for channel in every if becomes_video(channel)]
    found = CompactResult(
        state="no-pictures", episode_id=reader.episode_id or folder.name, path=str(folder),
        kept=sorted({channel.topic for channel in every if channel.is_typed and channel.is_depth}),
    )  # fmt: skip
    if not channels:
        return found
    manifest, files = reader.manifest, measure(folder)
    cameras = next(file for file in files if file.name == layout.CAMERAS)
    is_video = any(channel.video for channel in channels)
    # One that was killed before the manifest was written, which still names the file that is gone.
    note = _note_in(reader.parts[1]) if is_video and manifest.compacted is None else None
    described = cameras if note is None else note.made_of
    if changed := changes(manifest.files, [file for file in files if file is not cameras] + [described]):
        raise EpisodeError(f"{folder}: was changed after it was closed ({words(changed)}); left as it is")
    if is_video and note is None:
        found = msgspec.structs.replace(found, state="current", bytes_after=cameras.bytes)
        return found if manifest.compacted is None else _of(manifest.compacted, cameras.bytes, found)
    if note is None:
        _expect_room(folder, cameras.bytes)
        found = msgspec.structs.replace(found, bytes_before=cameras.bytes)
    if dry_run:
        return msgspec.structs.replace(found, state="compacted")
    if note is None:
        try:
            note = _replace(folder / layout.CAMERAS, cameras, crf, gop, progress)
        except Unfit as error:
            return msgspec.structs.replace(found, state="left", why=str(error), seconds=time.perf_counter() - began)
    _note(folder, note)
    found = msgspec.structs.replace(found, state="compacted", seconds=time.perf_counter() - began)
    return _of(note, note.bytes, found)


def _expect_whole(reader: EpisodeReader) -> None:
    if reader.torn is not None or reader.is_active:
        what = reader.torn or "was never finished"
        raise EpisodeError(f"{reader.folder.name}: {what}; first: station episodes repair {reader.folder.name}")


def _note_in(part: Part) -> Compacted | None:
    """Return what a file of video says of how it was made; None where it lost that with its end."""
    written = part.contents.metadata.get(layout.COMPACTED_RECORD)
    if written is None:
        return None
    try:
        return msgspec.json.decode(written.get(_NOTE, ""), type=Compacted)
    except (msgspec.DecodeError, RecursionError) as error:
        raise EpisodeError(f"{part.path}: what it says of its compacting cannot be read: {error}") from error


def _expect_room(folder: Path, size: int) -> None:
    free, wanted = shutil.disk_usage(folder).free, size // _ROOM
    if free < wanted:
        raise EpisodeError(
            f"{folder}: {free / 1e6:.0f} MB free, {wanted / 1e6:.0f} MB wanted for the new file beside the old one; "
            "make room"
        )


def _of(note: Compacted, size: int, found: CompactResult) -> CompactResult:
    """Return a result with what a note says."""
    cameras = note.cameras.values()
    return msgspec.structs.replace(
        found, bytes_before=note.made_of.bytes, bytes_after=size, pictures=sum(camera.pictures for camera in cameras),
        psnr_db=min(camera.psnr_db for camera in cameras),
        psnr_worst_db=min(camera.psnr_worst_db for camera in cameras),
    )  # fmt: skip


def _replace(path: Path, made_of: RecordedFile, crf: int, gop: int, progress: Progress | None) -> Compacted:
    """Put the new file in the place of the old one, and return what is to be said of it."""
    note = Compacted(
        at=iso(time.time_ns()), software=msgspec.to_builtins(software()),
        encoder={"name": "libx264", **X264, "crf": crf, "gop": gop}, cameras={}, made_of=made_of,
    )  # fmt: skip
    with whole_file(path) as file:
        _write(file, path, note, crf, gop, progress)
    return note


def _write(file: BinaryIO, path: Path, note: Compacted, crf: int, gop: int, progress: Progress | None) -> None:
    """Write the new file, read it back, and put into it what its manifest will say; or raise, and nothing is lost."""
    old = Part(path)
    tell = _Progress(
        progress, 2 * sum(count for number, count in old.contents.counts.items() if number != STAMPS_NUMBER)
    )
    made = VideoFile(file, old, crf=crf, gop=gop)
    for message in tell.counted(_stored(old)):
        made.add(message)
    made.end_chunk()
    file.flush()
    new = Part(part_of(path))
    note.cameras = compared(old, new, tell)
    for key, camera in note.cameras.items():
        if camera.psnr_db < LEAST_DB:
            raise Unfit(
                f"{key}: PSNR {camera.psnr_db:.1f} dB (worst {camera.psnr_worst_db:.1f}), {LEAST_DB:.0f} dB are the "
                f"least; a lower --crf than {crf} keeps more"
            )
    made.finish({_NOTE: msgspec.json.encode(note).decode()})
    file.flush()
    if file.tell() >= note.made_of.bytes:
        raise Unfit(f"as H.264 they take {file.tell() / 1e6:.1f} MB, no less than as JPEG files")
    finished = Part(new.path)
    if finished.torn is not None or finished.contents.chunks != new.contents.chunks:
        raise EpisodeError(f"{new.path}: is not what was written; look after the disk")


def compared(old: Part, new: Part, tell: _Progress | None = None) -> dict[str, CompactedCamera]:
    """Return how alike the pictures of two files are by camera, each as a reader gets it; all else must be equal.

    Raises:
        EpisodeError: a message, a time of one or a stamp is another, or one is missing.
    """
    losses: defaultdict[str, list[float]] = defaultdict(list)
    decoder = JpegDecoder()
    opened, stored = new.in_file_order(None), _stored(new)
    counted = stored if tell is None else tell.counted(stored)
    for number, (one, other, read) in enumerate(zip_longest(_stored(old), counted, opened)):
        if one is None or other is None or read is None or _all_but_picture(one) != _all_but_picture(other):
            raise EpisodeError(f"{new.path}: message {number} is not that of {old.path.name}; look after the disk")
        if not becomes_video(one.channel):
            continue
        shown, kept = (decoder.picture(jpeg) for jpeg in (pictures.picture_in(one.data), read.data))
        losses[one.topic].append(psnr_db(planes(in_planes(shown)), planes(kept)))
    return {
        key: CompactedCamera(
            pictures=len(found), psnr_db=round(float(np.mean(found)), 2), psnr_worst_db=round(min(found), 2)
        )
        for key, found in sorted(losses.items())
    }


def _all_but_picture(message: Message) -> tuple[object, ...]:
    """Return everything of a stored message that compacting must not change."""
    told = pictures.time_in(message.data) if becomes_video(message.channel) else message.data
    channel = msgspec.structs.replace(message.channel, video="", file="")
    return channel, message.log_ns, message.publish_ns, message.sequence, message.stamp, told


def _stored(part: Part) -> Iterator[Message]:
    return part.in_file_order(None, stamps=True, raw=True)


def _note(folder: Path, note: Compacted) -> None:
    """Write into the manifest what the new file says, and let the verdict of the old one stand."""
    manifest = manifest_to_change(folder)
    note_files(manifest, folder)
    note.bytes = (folder / layout.CAMERAS).stat().st_size
    note.verdict = _carry_verdict(manifest, note.made_of)
    manifest.compacted = note
    save_manifest(manifest, folder)


def _carry_verdict(manifest: Manifest, made_of: RecordedFile) -> str:
    """Have what a check measured of the JPEG pictures stand for these, and return its verdict; "" where none stood.

    It saw more than another check could: every time is the same, and of the pictures it had the better ones.
    """
    try:
        measured = msgspec.convert(manifest.quality.get("files", []), list[RecordedFile])
    except msgspec.ValidationError:  # no check of ours wrote it
        return ""
    before = [made_of if file.name == layout.CAMERAS else file for file in manifest.files]
    if not measured or changes(measured, before):
        return ""
    manifest.quality["files"] = msgspec.to_builtins(manifest.files)
    return str(manifest.quality.get("verdict", ""))


class _Progress:
    """Counts messages on their way."""

    def __init__(self, tell: Progress | None, total: int) -> None:
        self._tell, self._total, self._done = tell, total, 0

    def counted(self, messages: Iterator[Message]) -> Iterator[Message]:
        """Pass messages on."""
        for message in messages:
            self._done += 1
            if self._tell is not None and self._done % _TELL_EVERY == 0:
                self._tell(self._done, self._total)
            yield message
