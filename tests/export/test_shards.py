"""A shard is kept for as long as what let its episode in says the same."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from station import registry
from station.episode.quality import rule_file
from station.episode.quality.check import check, write_measured
from station.episode.reading.reader import open_episode
from station.episode.storage.manifest import load_manifest, save_manifest
from station.export import shards, verdict
from station.export.kind import ExportKind, Source
from station.export.run import Workers, export, preview
from tests.export.pictured import walked

STRICT, LAX = "gap: {usable_above_s: 0.001, reject_above_s: 0.001}", "gap: off"


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where this user's rules are kept."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    (tmp_path / "station").mkdir()
    return tmp_path / "station" / "quality.yaml"


@pytest.fixture
def source(tmp_path: Path) -> Source:
    return walked(tmp_path / "data", seconds=0.3, camera_hz=0)


def made_by(lab: Path, source: Source, tmp_path: Path, *rules: str, between: Callable[[], None] = lambda: None) -> str:
    """Make the same shard by one set of rules after the other; return what became of it."""
    kind: ExportKind = registry.find("export", "npz")
    options = kind.options(min_quality="usable")
    found = []
    with shards.open_work(tmp_path / "out") as work:
        for text in rules:
            lab.write_text(text)
            book = verdict.rule_book(options.min_quality)
            task = shards.Task(
                format=kind.name, source=source, plan=kind.prepare([source], options), min_quality=options.min_quality,
                work=str(work), book=book,
            )  # fmt: skip
            found.append(shards.make_shard(task).status)
            between()
    return " ".join(found)


def test_an_episode_that_nobody_checked_is_judged_again_by_other_rules(
    lab: Path, source: Source, tmp_path: Path
) -> None:
    assert made_by(lab, source, tmp_path, LAX, LAX, "slow: off", STRICT) == "made kept made left-out"


def test_the_verdict_of_a_check_stands_whatever_the_rules_are_now(lab: Path, source: Source, tmp_path: Path) -> None:
    folder = Path(source.folder)
    write_measured(folder, check(open_episode(str(folder))))
    assert made_by(lab, source, tmp_path, LAX, STRICT) == "made kept"


def test_who_is_left_out_by_rules_of_another_day_is_told_how_to_be_judged_anew(lab: Path, source: Source) -> None:
    folder = Path(source.folder)
    lab.write_text(STRICT)
    write_measured(folder, check(open_episode(str(folder)), rule_file.of_user()))
    cure = "; by other rules than today's, `station check` it anew"
    for rules, is_told in ((STRICT, False), (LAX, True)):
        lab.write_text(rules)
        with pytest.raises(verdict.NotWanted, match=r": reject, .* silent for ") as refused:
            verdict.expect(source, "usable")
        assert str(refused.value).endswith(cure) == is_told


def test_what_somebody_says_of_an_episode_after_its_check_is_judged(lab: Path, source: Source, tmp_path: Path) -> None:
    folder = Path(source.folder)
    write_measured(folder, check(open_episode(str(folder))))

    def discard() -> None:
        manifest = load_manifest(folder)
        manifest.quality_flags.discarded = True
        save_manifest(manifest, folder)

    assert made_by(lab, source, tmp_path, LAX, LAX, between=discard) == "made left-out"


def test_all_episodes_of_an_export_are_judged_by_the_rules_at_its_beginning(lab: Path, tmp_path: Path) -> None:
    sources = [walked(tmp_path / "data", number, seconds=0.3, camera_hz=0) for number in (1, 2, 3)]
    kind: ExportKind = registry.find("export", "npz")
    options, where = kind.options(min_quality="usable"), Workers(jobs=1)

    def change(_: object = None) -> None:
        lab.write_text(STRICT)

    lab.write_text(LAX)
    looked = preview(kind, sources, options, where=where, on_done=change)
    assert [each.episode_id for each in looked.sources] == [each.episode_id for each in sources]
    lab.write_text(LAX)
    done = export(kind, sources, options, tmp_path / "out", where=where, on_done=change)
    assert (done.episodes, done.left_out) == (3, ())


def test_where_any_episode_will_do_no_rules_are_read(lab: Path, source: Source) -> None:
    lab.write_text("no such rule: 1")
    assert verdict.rule_book("any") is None
    assert verdict.expect(source, "any") == verdict.VerdictCheck(None, ())
