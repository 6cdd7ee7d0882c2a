"""An export and a report say the same of an episode: what was measured, what was said since, what nobody measured."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from station.episode.quality import rule_file
from station.episode.quality.check import check, write_measured
from station.episode.quality.findings import Reason, Verdict
from station.episode.quality.standing import standing
from station.episode.reading.reader import open_episode
from station.episode.storage.manifest import load_manifest, save_manifest
from station.export import verdict
from station.export.kind import Source
from station.report.gather import gather
from tests.episode.synthetic import EpisodeBuilder, walk


def unmeasured(_: Path) -> None:
    """Nobody has checked it."""


def measured(folder: Path, *, verdict: Verdict = "usable") -> None:
    """Checked, with a verdict that today's rules would not give."""
    quality = check(open_episode(folder))
    quality.verdict, quality.reasons = verdict, [Reason("gap", verdict, "as it was written")]
    write_measured(folder, quality)


def discarded_since(folder: Path) -> None:
    measured(folder)
    flagged(folder, discarded=True)


def taken_back_since(folder: Path) -> None:
    flagged(folder, discarded=True)
    measured(folder, verdict="reject")
    flagged(folder, discarded=False)


def measured_by_less(folder: Path) -> None:
    """Checked before `arms` were measured."""
    measured(folder, verdict="reject")
    manifest = load_manifest(folder)
    del manifest.quality["arms"]
    save_manifest(manifest, folder)


def flagged(folder: Path, *, discarded: bool) -> None:
    manifest = load_manifest(folder)
    manifest.quality_flags.discarded = discarded
    save_manifest(manifest, folder)


@pytest.mark.parametrize(
    ("since", "expected", "reason"),
    [
        (unmeasured, "good", None),
        (measured, "usable", "as it was written"),
        (discarded_since, "reject", "marked as discarded"),
        (taken_back_since, "good", None),
        (measured_by_less, "good", None),
    ],
)
def test_an_export_and_a_report_say_the_same_of_an_episode(
    tmp_path: Path, since: Callable[[Path], None], expected: Verdict, reason: str | None
) -> None:
    builder = EpisodeBuilder(tmp_path)
    walk(builder, seconds=1.0)
    folder = builder.finish({})
    since(folder)
    book = rule_file.shipped()
    (reported,), unread = gather([folder], book, named=True)
    source = Source(episode_id=folder.name, folder=str(folder))
    assert unread == []
    assert reported.quality == standing(open_episode(folder), book)
    assert (reported.quality.verdict, *[item.text for item in reported.quality.reasons][:1]) == (
        (expected,) if reason is None else (expected, reason)
    )
    if expected == "reject":
        with pytest.raises(verdict.NotWanted, match=f"{folder.name}: reject, .*asks for usable: {reason}"):
            verdict.expect(source, "usable")
    else:
        judged = verdict.expect(source, "usable")
        assert judged.verdict == expected
        assert judged.rules == (() if since is measured else book.files), "of what was judged now"
