"""How good an episode is as things stand: by what a check wrote into its manifest, or measured now."""

from __future__ import annotations

import msgspec

from station.episode.quality.check import check
from station.episode.quality.findings import Quality
from station.episode.quality.rule_file import RuleBook
from station.episode.quality.rules import judge
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.manifest import Manifest


def standing(reader: EpisodeReader, book: RuleBook, *, is_judged_anew: bool = False) -> Quality:
    """Return the quality of an episode, measured only where no check has written all that is measured today.

    Args:
        reader: The episode.
        book: The rules for what is judged now: where nothing `stands`.
        is_judged_anew: Whether they are laid on what was measured in any case.

    Raises:
        EpisodeError: it has to be measured, and cannot be read.
    """
    if not is_judged_anew and (found := stands(reader.manifest)) is not None:
        return found
    quality = _written(reader.manifest)
    if quality is None:
        return check(reader, book)
    flags = reader.manifest.quality_flags
    quality.discarded, quality.success = flags.discarded, flags.success
    quality.verdict, quality.reasons = judge(quality, book.limits)
    quality.rules = list(book.files)
    return quality


def stands(manifest: Manifest) -> Quality | None:
    """Return what a check wrote of an episode, by whatever rules; None where that is to be judged now.

    That is where no check has written all that is measured today, or somebody has said since that the episode is to be
    discarded, or whether the task was done.
    """
    quality, flags = _written(manifest), manifest.quality_flags
    if quality is None or (quality.discarded, quality.success) != (flags.discarded, flags.success):
        return None
    return quality


def _written(manifest: Manifest) -> Quality | None:
    """Return what a check wrote into a manifest, or None where it wrote nothing, or less than is measured today."""
    if not set(Quality.__struct_fields__) <= manifest.quality.keys():
        return None
    try:
        return msgspec.convert(manifest.quality, Quality)
    except msgspec.ValidationError:
        return None
