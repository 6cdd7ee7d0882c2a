"""How good an episode is as things stand: by what a check wrote into its manifest, or measured now."""

from __future__ import annotations

import msgspec

from station.episode.quality.check import check, files_of
from station.episode.quality.findings import Quality
from station.episode.quality.rule_file import RuleBook
from station.episode.quality.rules import judge
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.file_hashes import changes
from station.episode.storage.manifest_copy import changed_fields


def standing(reader: EpisodeReader, book: RuleBook, *, is_judged_anew: bool = False) -> Quality:
    """Return the quality of an episode, measured only where no check has written all that is measured today.

    Args:
        reader: The episode.
        book: The rules for what is judged now: where nothing `stands`.
        is_judged_anew: Whether they are laid on what was measured in any case.

    Raises:
        EpisodeError: it has to be measured, and cannot be read.
    """
    quality = _written(reader)
    if quality is None:
        return check(reader, book)
    if not is_judged_anew and _says_the_same(quality, reader):
        return quality
    flags = reader.manifest.quality_flags
    quality.discarded, quality.success = flags.discarded, flags.success
    quality.verdict, quality.reasons = judge(quality, book.limits)
    quality.rules = list(book.files)
    return quality


def stands(reader: EpisodeReader) -> Quality | None:
    """Return what a check wrote of an episode, by whatever rules; None where that is to be judged now.

    That is where no check has written all that is measured today, or what it measured were other files, or another
    manifest; or somebody has said since that the episode is to be discarded, or whether the task was done.

    Raises:
        EpisodeError: its files cannot be read.
    """
    quality = _written(reader)
    return quality if quality is not None and _says_the_same(quality, reader) else None


def _says_the_same(quality: Quality, reader: EpisodeReader) -> bool:
    """Whether success and discarding, from which its verdict follows, are still what the check saw."""
    flags = reader.manifest.quality_flags
    return (quality.discarded, quality.success) == (flags.discarded, flags.success)


def _written(reader: EpisodeReader) -> Quality | None:
    """Return what a check wrote into a manifest, or None where it wrote nothing, or less than is measured today.

    Likewise where it measured other files than those that are there, or the manifest has been changed since.
    """
    manifest = reader.manifest
    if not set(Quality.__struct_fields__) <= manifest.quality.keys():
        return None
    try:
        quality = msgspec.convert(manifest.quality, Quality)
    except msgspec.ValidationError:
        return None
    found = files_of(reader)
    if changes(quality.files, found) or changes(manifest.files, found) != quality.changed:
        return None
    return quality if changed_fields(manifest, reader.attachments()) == quality.manifest_changed else None
