"""Which episodes are good enough to be exported: by what `station check` wrote, or measured now."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from station.episode.quality.finding_parts import RulesFile
from station.episode.quality.findings import Verdict
from station.episode.quality.rule_file import RuleBook, of_user
from station.episode.quality.standing import standing, stands
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.folder import signals_file
from station.errors import EpisodeError
from station.export.kind import MinQuality, Source, Success

_RANK: dict[str, int] = {"any": 0, "reject": 0, "usable": 1, "good": 2}


class NotWanted(EpisodeError):
    """An episode that is not asked for: by its verdict, by what its operator said, or for want of rows."""


class VerdictCheck(NamedTuple):
    """How an episode was found good enough.

    Attributes:
        verdict: None where any would do and no check has said one of these files.
        rules: Files of the rules that said so now, each with its hash; none where the verdict in the manifest stands.
    """

    verdict: Verdict | None
    rules: tuple[RulesFile, ...] = ()


def rule_book(least: MinQuality) -> RuleBook | None:
    """Return this user's rules, to be read once for a whole export; None where any episode will do.

    Raises:
        BadFile, ConfigError: as `station.episode.quality.rule_file.load`.
    """
    return None if least == "any" else of_user()


def expect(
    source: Source, least: MinQuality, book: RuleBook | None = None, *, success: Success = "any"
) -> VerdictCheck:
    """Refuse an episode whose verdict is less than asked for, or of which the operator said something else.

    The verdict that a check wrote stands, by whatever rules; these rules are for what has none.

    Args:
        source: The episode.
        least: What is asked for.
        book: The rules; None has this user's read.
        success: What the operator shall have said.

    Raises:
        NotWanted: less than `least`, with the first reason; or another success than asked for.
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
    _expect_success(source, reader.manifest.quality_flags.success, success)
    written = stands(reader)
    if least == "any":
        return VerdictCheck(written.verdict if written is not None else None)
    book = book or of_user()
    quality = written or standing(reader, book)
    found = quality.verdict
    if _RANK[found] < _RANK[least]:
        reason = next((item.text for item in quality.reasons if item.verdict == found), "see `station check`")
        cure = "" if _are_same(quality.rules, book.files) else "; by other rules than today's, `station check` it anew"
        raise NotWanted(f"{source.episode_id}: {found}, and --min-quality asks for {least}: {reason}{cure}")
    return VerdictCheck(found, () if written else tuple(quality.rules))


def _expect_success(source: Source, said: bool | None, wanted: Success) -> None:
    if wanted != "any" and said is not (wanted == "yes"):
        word = "neither a success nor a failure" if said is None else "a success" if said else "a failure"
        raise NotWanted(f"{source.episode_id}: the operator called it {word}, and --success asks for {wanted}")


def _are_same(some: Iterable[RulesFile], others: Iterable[RulesFile]) -> bool:
    """Whether files of rules say the same, wherever they lie."""
    return [file.sha256 for file in some] == [file.sha256 for file in others]
