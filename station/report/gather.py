"""What a report knows of each episode before it looks into the signals: its manifest, and what was measured of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import msgspec

from station.episode.quality.findings import Quality
from station.episode.quality.rule_file import RuleBook
from station.episode.quality.standing import standing
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.folder import signals_file
from station.episode.storage.manifest import Manifest
from station.errors import EpisodeError


@dataclass(frozen=True)
class Episode:
    """An episode of a report.

    Attributes:
        folder: Where it is.
        manifest: Its manifest, less what `quality` has as well.
        quality: What was measured of it.
        is_named: Whether it was asked for by name.
    """

    folder: Path
    manifest: Manifest
    quality: Quality
    is_named: bool

    @property
    def name(self) -> str:
        """Its id, or its folder where it has none."""
        return self.manifest.episode_id or self.folder.name

    @property
    def started(self) -> datetime | None:
        """When it was started; None where nothing says."""
        try:
            return datetime.fromisoformat(self.manifest.timing.started).astimezone()
        except (ValueError, OverflowError):
            return None

    @property
    def discarded_for(self) -> str:
        """Why it was discarded, "" where that was not said."""
        begin = "discarded: "
        labels = [mark.label for mark in self.manifest.marks if mark.label.startswith(begin)]
        return labels[-1].removeprefix(begin) if labels else ""


@dataclass(frozen=True)
class UnreadableEpisode:
    """An episode that cannot be reported on, and why."""

    name: str
    problem: str


def gather(
    folders: Iterable[Path], book: RuleBook, *, named: bool, is_judged_anew: bool = False,
    tell: Callable[[], None] = lambda: None,
) -> tuple[list[Episode], list[UnreadableEpisode]]:  # fmt: skip
    """Read episodes, measuring those that were not checked since anything about them changed.

    Args:
        folders: Where they are.
        book: The rules for those that are measured now.
        named: Whether they were asked for by name.
        is_judged_anew: Whether the rules are laid on all of them.
        tell: Called after each.
    """
    found: list[Episode] = []
    unread: list[UnreadableEpisode] = []
    for folder in folders:
        try:
            found.append(_read(folder, book, named=named, is_judged_anew=is_judged_anew))
        except EpisodeError as error:
            unread.append(UnreadableEpisode(folder.name, str(error)))
        tell()
    return found, unread


def _read(folder: Path, book: RuleBook, *, named: bool, is_judged_anew: bool) -> Episode:
    reader = EpisodeReader(signals_file(folder))
    manifest = reader.manifest
    slim = msgspec.structs.replace(manifest, streams=[], quality={})
    return Episode(reader.folder, slim, standing(reader, book, is_judged_anew=is_judged_anew), named)
