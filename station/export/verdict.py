"""Which episodes are good enough to be exported: by what `station check` wrote, or measured now."""

from __future__ import annotations

from pathlib import Path

from station.episode.quality.finding_parts import RulesFile
from station.episode.quality.findings import Verdict
from station.episode.quality.rule_file import of_user
from station.episode.quality.standing import standing
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.folder import signals_file
from station.errors import EpisodeError
from station.export.kind import MinQuality, Source

_RANK: dict[str, int] = {"any": 0, "reject": 0, "usable": 1, "good": 2}


class NotGoodEnough(EpisodeError):
    """An episode whose verdict is less than an export asks for."""


def rules(least: MinQuality) -> list[RulesFile]:
    """Return the files that decide, each with its hash; none where any episode will do."""
    return [] if least == "any" else list(of_user().files)


def expect(source: Source, least: MinQuality) -> Verdict | None:
    """Refuse an episode whose verdict is less than asked for; return the verdict, None where none was needed.

    Raises:
        NotGoodEnough: less than `least`, with the first reason.
        EpisodeError: not finished, whatever is asked for, or not to be read.
    """
    reader = EpisodeReader(signals_file(Path(source.folder)))
    if reader.is_active:
        why = (reader.torn or "its recorder is still at it").removeprefix("not finished: ")
        raise EpisodeError(
            f"{source.episode_id}: not finished: {why}; stop the recording, or `station episodes repair` it"
        )
    if not any(stream.count for stream in reader.streams()):
        raise EpisodeError(f"{source.episode_id}: holds no message; there is nothing to export")
    if least == "any":
        return None
    quality = standing(reader, of_user())
    found = quality.verdict
    if _RANK[found] < _RANK[least]:
        reason = next((item.text for item in quality.reasons if item.verdict == found), "see `station check`")
        raise NotGoodEnough(f"{source.episode_id}: {found}, and --min-quality asks for {least}: {reason}")
    return found
