"""What a recording needs to know, and what it says to the world around it."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from station.episode.progress import WriterOptions
from station.life.events import Severity


class RecordingOptions(msgspec.Struct, frozen=True, kw_only=True):
    """What a recording needs to know.

    Attributes:
        data: Data folder.
        preroll_s: How much of what came before the start belongs to an episode [s].
        preroll_bytes: Bound of the memory for that.
        min_free_mb: Free disk space below which no episode starts [MB].
        task: Name of the task where a request gives none.
        writer: How to write.
        config: What the manifest says of the recorder's configuration.
    """

    data: Path
    preroll_s: float = 2.0
    preroll_bytes: int = 256 * 1024 * 1024
    min_free_mb: float = 500.0
    task: str = "untitled"
    writer: WriterOptions = WriterOptions()
    config: dict[str, Any] = {}


class Notice(NamedTuple):
    """Something that belongs on the bus as an event."""

    name: str
    severity: Severity
    numbers: dict[str, Any]


def no_space(data: Path, min_free_mb: float) -> str | None:
    """Return why the disk of a data folder is no place for an episode, or None when it is."""
    folder = data.absolute()
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:
        free_mb = shutil.disk_usage(folder).free / 1e6
    except OSError as error:
        return f"data folder {data}: {error.strerror}; name another with --data"
    if free_mb < min_free_mb:
        return (
            f"data folder {data}: {free_mb:.0f} MB free, at least {min_free_mb:.0f} MB wanted; "
            "free some, or name another with --data"
        )
    return None
