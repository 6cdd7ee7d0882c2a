"""What an enriched file was made of, so that it is made anew when that has changed and not otherwise."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import NamedTuple

import msgspec

from station.episode.reading.reader import EpisodeReader
from station.episode.storage.records import metadata_at_head
from station.errors import EpisodeError

ENRICHED = "enriched.mcap"
RECORD = "station.enriched"
"""Metadata record at the head of an enriched file: what it was made of, and in which manner."""

VERSION = 2
"""Of the topics and message types (`station.enrich.siblings`); counted up when the same recording gives others."""


class Origin(msgspec.Struct, frozen=True):
    """One file of the recording: name, size and hash."""

    file: str
    bytes: int
    sha256: str


class Identity(NamedTuple):
    """What the system says of a file; it differs when the file was written or replaced."""

    path: Path
    inode: int
    bytes: int
    modified_ns: int


def identities(reader: EpisodeReader, *, pictures: bool = True) -> list[Identity]:
    """Return what the system says of the files that an episode is read from; without pictures, of the signals alone.

    Raises:
        EpisodeError: one of them is gone.
    """
    return [_identity(path) for path in (reader.files if pictures else [reader.path])]


def origins(found: list[Identity]) -> list[Origin]:
    """Read and hash files.

    Raises:
        EpisodeError: one of them cannot be read.
    """
    made = []
    for path, *_ in found:
        try:
            with path.open("rb") as file:
                made.append(Origin(path.name, path.stat().st_size, hashlib.file_digest(file, "sha256").hexdigest()))
        except OSError as error:
            raise EpisodeError(f"{path}: cannot be read: {error.strerror}") from error
    return made


def facts(episode_id: str, made_of: list[Origin], *, pictures: bool = True) -> dict[str, str]:
    """Return the metadata record of an enriched file."""
    return {
        "version": str(VERSION),
        "episode_id": episode_id,
        "made_of": msgspec.json.encode(made_of).decode(),
        **({} if pictures else {"pictures": "left out"}),
    }


def is_current(path: Path, wanted: dict[str, str]) -> bool:
    """Whether an enriched file is there and was made of the same files in the same manner."""
    return path.is_file() and metadata_at_head(path, RECORD) == wanted


def _identity(path: Path) -> Identity:
    try:
        status = path.stat()
    except OSError as error:
        raise EpisodeError(f"{path}: cannot be read: {error.strerror}") from error
    return Identity(path, status.st_ino, status.st_size, status.st_mtime_ns)
