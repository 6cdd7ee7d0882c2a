"""What a recording needs to know, and what it says to the world around it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from station.episode.storage.progress import WriterOptions
from station.life.events import Severity


class RecordingOptions(msgspec.Struct, frozen=True, kw_only=True):
    """What a recording needs to know.

    Attributes:
        data: Data folder.
        preroll_s: How much of what came before the start belongs to an episode [s].
        preroll_bytes: Bound of the memory for that.
        min_free_mb: Free disk space that is left alone [MB]: no episode starts that would need it, and one that comes
            to it is ended, whole.
        planned_s: Time that must fit on the disk where a request plans none [s].
        warn_minutes: Warn when an episode has less than this left [min], and at each half of it.
        task: Name of the task where a request gives none.
        leave_out: Keys that every episode does without, or beginnings of keys up to a ``_``.
        writer: How to write.
        config: What the manifest says of the recorder's configuration.
    """

    data: Path
    preroll_s: float = 2.0
    preroll_bytes: int = 256 * 1024 * 1024
    min_free_mb: float = 500.0
    planned_s: float = 60.0
    warn_minutes: float = 10.0
    task: str = "untitled"
    leave_out: tuple[str, ...] = ()
    writer: WriterOptions = WriterOptions()
    config: dict[str, Any] = {}


class Notice(NamedTuple):
    """Something that belongs on the bus as an event."""

    name: str
    severity: Severity
    numbers: dict[str, Any]
