"""What tells the files of a closed recording from all others: their sizes, their indexes' checksums, their hashes.

Two depths. `glance` reads the last bytes of a file: its size, and the checksum of its summary, which names the time and
the place of each chunk. `measure` reads the signals whole, for a hash that ``sha256sum`` gives too. Pictures and clouds
are gigabytes, and whoever stops a recording waits: of those it takes the checksums of the chunks, which every reader
compares with the contents.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import msgspec
from mcap.opcode import Opcode

from station.episode.storage import layout
from station.episode.storage.manifest_parts import RecordedFile
from station.episode.storage.tail import read_footer

NOT_THERE = "not there"
_HEAD = struct.Struct("<BQ")
_PLACE = struct.Struct("<QQQ")  # of a chunk's index: first and last time, and where the chunk begins
_CHECKSUM = struct.Struct("<L")
_BEFORE_CHECKSUM = _HEAD.size + 24  # of a chunk: first and last time, size
_LARGEST_SUMMARY = 64 << 20  # of pictures; an hour of three cameras has 1 MB
_TOLD = {
    "bytes": "{} bytes", "sha256": "sha256 {:.16}…", "summary_crc": "a summary of checksum {}",
    "chunks_sha256": "chunks of sha256 {:.16}…",
}  # fmt: skip


class FileChange(msgspec.Struct, frozen=True, kw_only=True):
    """A file that is not the one that was expected.

    Attributes:
        name: Its name.
        expected, found: In what they differ, in words; ``not there`` where one of them is not.
    """

    name: str
    expected: str
    found: str


def glance(folder: Path) -> list[RecordedFile]:
    """Return size and checksum of the summary of each closed file of an episode.

    Raises:
        OSError: one cannot be read.
    """
    return [_read(path, is_whole=False) for path in _closed(folder)]


def measure(folder: Path) -> list[RecordedFile]:
    """Return everything that tells the closed files of an episode from others.

    Raises:
        OSError: one cannot be read.
    """
    return [_read(path, is_whole=True) for path in _closed(folder)]


def changes(expected: Sequence[RecordedFile], found: Sequence[RecordedFile]) -> list[FileChange]:
    """Return how files differ, in what is known of both; nothing where nothing is known of those that are expected."""
    if not expected:
        return []
    told, present = ({file.name: file for file in files} for files in (expected, found))
    pairs = ((name, told.get(name), present.get(name)) for name in sorted({*told, *present}))
    return [change for name, one, other in pairs if (change := _change(name, one, other)) is not None]


def words(found: Iterable[FileChange]) -> str:
    """Return in a line what differs."""
    return "; ".join(f"{one.name}: expected {one.expected}, found {one.found}" for one in found)


def _change(name: str, expected: RecordedFile | None, found: RecordedFile | None) -> FileChange | None:
    if expected is None or found is None:
        there = [NOT_THERE if one is None else f"{one.bytes} bytes" for one in (expected, found)]
        return FileChange(name=name, expected=there[0], found=there[1])
    for what, say in _TOLD.items():
        one, other = getattr(expected, what), getattr(found, what)
        if one != other and one and other:
            return FileChange(name=name, expected=say.format(one), found=say.format(other))
    return None


def _closed(folder: Path) -> Iterator[Path]:
    return (path for names in layout.ALL_NAMES if (path := folder / names.final).is_file())


def _read(path: Path, *, is_whole: bool) -> RecordedFile:
    with path.open("rb") as file:
        size = file.seek(0, 2)
        footer = read_footer(file, size)
        found = RecordedFile(name=path.name, bytes=size)
        if footer is not None:
            found.summary_crc = f"{footer.summary_crc:08x}"
        if not is_whole:
            return found
        if path.name != layout.SIGNALS:
            found.chunks_sha256 = "" if footer is None else _chunks_sha256(file, footer.summary_start, size)
        else:
            file.seek(0)
            found.sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        return found


def _chunks_sha256(file: BinaryIO, start: int, size: int) -> str:
    """Return the hash of the checksums of all chunks, in the order of the summary; "" where it leads nowhere."""
    if size - start > _LARGEST_SUMMARY:
        return ""
    file.seek(start)
    summary, position, found = file.read(size - start), 0, hashlib.sha256()
    while position + _HEAD.size + _PLACE.size <= len(summary):
        opcode, length = _HEAD.unpack_from(summary, position)
        if opcode == Opcode.CHUNK_INDEX:
            _, _, place = _PLACE.unpack_from(summary, position + _HEAD.size)
            if place + _BEFORE_CHECKSUM + _CHECKSUM.size > size:
                return ""
            file.seek(place + _BEFORE_CHECKSUM)
            found.update(file.read(_CHECKSUM.size))
        position += _HEAD.size + length
    return found.hexdigest()
