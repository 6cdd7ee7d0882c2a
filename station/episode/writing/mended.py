"""One file of an episode made whole: a copy of what is whole of it, opened at its end."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO, NamedTuple

import mcap.records
import msgspec

from station.episode.storage import layout
from station.episode.storage.anchor import Anchor
from station.episode.storage.drops import Drops, drops_of, larger
from station.episode.storage.manifest import Manifest, dump_manifest, facts_of
from station.episode.storage.records import RawMessage, walk
from station.episode.writing.file import EpisodeFile
from station.episode.writing.salvage import Salvaged, salvage
from station.errors import EpisodeError


class Cut(msgspec.Struct, frozen=True, kw_only=True):
    """What was cut of one file.

    Attributes:
        file: Name of the file that is good now.
        at, bytes: Where the whole part ended, and how much of the file lay behind it.
        seconds: From the last message kept to the last change of the torn file [s].
        original: Where the torn file is kept.
    """

    file: str
    at: int
    bytes: int
    seconds: float
    original: str = ""


class Mended(NamedTuple):
    """A file that was torn, or was not.

    Attributes:
        names: What it is called.
        source: The original, which nothing changes.
        salvaged: What is whole of it.
        file: The copy, open at its end; None where nothing was worth a copy.
    """

    names: layout.Names
    source: Path
    salvaged: Salvaged
    file: EpisodeFile | None

    @property
    def is_whole(self) -> bool:
        """Whether the original lacks nothing."""
        return self.salvaged.is_finished

    def cut(self) -> Cut:
        """Return what was cut."""
        state, last_ns = self.source.stat(), self.file.last_log_ns if self.file and self.file.messages else 0
        return Cut(
            file=self.names.final,
            at=self.salvaged.kept_to,
            bytes=state.st_size - self.salvaged.kept_to,
            seconds=round(max(0.0, (state.st_mtime_ns - last_ns) * 1e-9), 3) if last_ns else 0.0,
        )


def mend(source: Path, copy: Path, names: layout.Names, anchor: Anchor, manifest: Manifest, drops: Drops) -> Mended:
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
        salvaged = look_over(source, names, output)
    opened = _opened(copy, names, anchor, manifest, drops)
    if names is layout.CAMERAS_NAMES and opened is not None and not opened.messages:
        opened.close()
        opened = None
    if opened is None:
        copy.unlink(missing_ok=True)
    return Mended(names, source, salvaged, opened)


def _opened(copy: Path, names: layout.Names, anchor: Anchor, manifest: Manifest, drops: Drops) -> EpisodeFile | None:
    """Open what was saved; where not even the head of the signals was whole, with one made from the manifest."""
    if copy.stat().st_size and layout.EPISODE_RECORD in (found := walk(copy).metadata):
        known = larger(drops, drops_of(found.get(layout.DROPPED_RECORD)))
        return EpisodeFile.reopen(copy, anchor, names=names, drops=known)
    if names is layout.CAMERAS_NAMES:
        return None
    copy.unlink(missing_ok=True)
    return EpisodeFile.create(copy, anchor, facts_of(manifest), manifest=dump_manifest(manifest))


def look_over(source: Path, names: layout.Names, output: BinaryIO | None = None) -> Salvaged:
    """Go through a file for its wholeness alone; nothing is whole of pictures that are no MCAP file at all.

    Raises:
        OSError: it cannot be read, or its copy not written.
        EpisodeError: it is that of the signals, and no MCAP file.
    """
    try:
        return salvage(source, _take_no_note, output=output)
    except EpisodeError:
        if names is not layout.CAMERAS_NAMES:
            raise
        return Salvaged({}, {}, 0, b"", is_finished=False)  # the signals are worth saving all the same


def _take_no_note(_message: RawMessage, _channel: mcap.records.Channel) -> None:
    pass
