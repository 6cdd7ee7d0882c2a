"""Which episodes are good enough to be exported: by what `station check` wrote, or measured now."""

from __future__ import annotations

from pathlib import Path

from station.episode.quality.check import check
from station.episode.quality.findings import Verdict
from station.episode.quality.rule_file import of_user
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.folder import signals_file
from station.episode.storage.manifest import Manifest
from station.errors import EpisodeError
from station.export.kind import MinQuality, Source

_RANK: dict[str, int] = {"any": 0, "reject": 0, "usable": 1, "good": 2}


class NotGoodEnough(EpisodeError):
    """An episode whose verdict is less than an export asks for."""


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
    found, reason = _measured(reader.manifest) or _measure(reader)
    if _RANK[found] < _RANK[least]:
        raise NotGoodEnough(
            f"{source.episode_id}: {found}, and --min-quality asks for {least}: {reason or 'see `station check`'}"
        )
    return found


def _measured(manifest: Manifest) -> tuple[Verdict, str] | None:
    """Return verdict and worst reason that stand in a manifest; None when a person has said something else since."""
    block, flags = manifest.quality, manifest.quality_flags
    found = block.get("verdict")
    is_current = block.get("discarded") == flags.discarded and block.get("success") == flags.success
    if found not in ("good", "usable", "reject") or not is_current:
        return None
    reasons = [item for item in block.get("reasons") or [] if isinstance(item, dict)]
    return found, next((str(item.get("text", "")) for item in reasons if item.get("verdict") == found), "")


def _measure(reader: EpisodeReader) -> tuple[Verdict, str]:
    quality = check(reader, of_user())
    return quality.verdict, next((item.text for item in quality.reasons if item.verdict == quality.verdict), "")
