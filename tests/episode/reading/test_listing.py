from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from station.episode.reading import listing
from station.episode.reading.listing import EpisodeFilter, list_episodes, since
from station.episode.reading.reader import open_episode
from station.episode.reading.show import show
from station.episode.storage.manifest import Manifest, Operator, QualityFlags, Task, Timing, save_manifest
from station.errors import ConfigError
from tests.episode.synthetic import EpisodeBuilder


def test_a_data_folder_that_does_not_exist_holds_no_episodes(tmp_path: Path) -> None:
    assert list_episodes(tmp_path / "nowhere") == []


def test_rows_tell_finished_unfinished_failed_and_broken_apart(tmp_path: Path) -> None:
    states = {"a-0001": "finished", "b-0002": "recording", "c-0003": "failed"}
    for name, state in states.items():
        folder = tmp_path / "walk" / name
        folder.mkdir(parents=True)
        (folder / ("signals.mcap" if state == "finished" else "signals.mcap.active")).write_bytes(b"12345")
        save_manifest(
            Manifest(
                episode_id=name,
                state=state,
                task=Task(name="walk"),
                quality_flags=QualityFlags(discarded=True, falls=2),
            ),
            folder,
        )
    broken = tmp_path / "squat" / "d-0004"
    broken.mkdir(parents=True)
    (broken / "manifest.yaml").write_text("task: 3")
    rows = {row.episode_id: row for row in list_episodes(tmp_path)}
    assert {name: row.state for name, row in rows.items()} == {
        "a-0001": "finished", "b-0002": "unfinished", "c-0003": "failed", "d-0004": "broken",
    }  # fmt: skip
    assert rows["a-0001"].is_discarded
    assert (rows["a-0001"].falls, rows["a-0001"].size_bytes) == (2, 5)
    assert "task" in rows["d-0004"].problem
    assert {row.episode_id for row in list_episodes(tmp_path, task="walk")} == set(states)


def test_show_counts_the_streams_from_the_file(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    for n in range(10):
        builder.write({"own": b"[1]"}, at_s=n / 10)
    builder.skip("own")
    builder.write({"own": b"[1]"}, at_s=1.5)
    builder.foreign("plain", b"1", at_s=0.5)
    facts = show(open_episode(builder.finish()))
    own, plain = facts.streams
    assert (own.key, own.count, own.lost, own.writer, own.longest_gap_s) == ("own", 11, 1, "g1", 0.6)
    assert (plain.key, plain.count, plain.lost, plain.writer) == ("plain", 1, 0, "foreign")
    assert (facts.messages, facts.torn, [*facts.files]) == (12, None, ["signals.mcap"])
    assert facts.first_s is not None
    assert facts.first_s < 0.01


NOON = datetime(2026, 11, 21, 12, tzinfo=UTC)


@pytest.fixture
def takes(tmp_path: Path) -> Path:
    """Five takes, an hour apart, the last at noon: good, usable, rejected, unchecked, and good but discarded since."""
    verdicts = ("good", "usable", "reject", "", "good")
    for number, verdict in enumerate(verdicts):
        folder = tmp_path / "walk" / f"take-{number}"
        folder.mkdir(parents=True)
        (folder / "signals.mcap").write_bytes(b"12345")
        manifest = Manifest(
            episode_id=f"take-{number}", state="finished", operator=Operator(id="ada" if number < 3 else "bob"),
            quality_flags=QualityFlags(success=(True, None, False, None, True)[number], discarded=number == 4),
            quality={"verdict": verdict} if verdict else {},
            timing=Timing(started=(NOON - timedelta(hours=4 - number)).isoformat()),
        )  # fmt: skip
        save_manifest(manifest, folder)
    return tmp_path


@pytest.mark.parametrize(
    ("wanted", "expected"),
    [
        (EpisodeFilter(), [0, 1, 2, 3, 4]),
        (EpisodeFilter(least="usable"), [0, 1]),
        (EpisodeFilter(least="good"), [0]),
        (EpisodeFilter(verdicts=("reject", "unchecked")), [2, 3]),
        (EpisodeFilter(operator="bob"), [3, 4]),
        (EpisodeFilter(success="yes"), [0, 4]),
        (EpisodeFilter(success="no"), [2]),
        (EpisodeFilter(success="unknown"), [1, 3]),
        (EpisodeFilter(since=NOON - timedelta(hours=2)), [2, 3, 4]),
        (EpisodeFilter(operator="ada", least="usable", success="yes"), [0]),
    ],
)
def test_a_list_holds_what_is_wanted_and_nothing_else(takes: Path, wanted: EpisodeFilter, expected: list[int]) -> None:
    names = sorted(row.episode_id for row in list_episodes(takes, wanted=wanted))
    assert names == [f"take-{number}" for number in expected]


def test_since_is_a_time_ago_or_a_day() -> None:
    assert since("2h", NOON) == NOON - timedelta(hours=2)
    assert since("1.5d", NOON) == NOON - timedelta(hours=36)
    assert since("2026-11-20", NOON) == datetime(2026, 11, 20).astimezone()
    assert since("2026-11-20T14:30", NOON) == datetime(2026, 11, 20, 14, 30).astimezone()


@pytest.mark.parametrize("text", ["yesterday", "2026-13-40", "nand", "", "-2h", "1e99d"])
def test_a_time_that_is_none_is_refused_in_a_line(text: str) -> None:
    with pytest.raises(ConfigError, match="--since: expected 2h, 3d, 2026-11-20") as caught:
        since(text)
    assert "\n" not in str(caught.value)


def test_the_newest_are_looked_at_again_only_where_something_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number in range(5):
        folder = tmp_path / "walk" / f"a-000{number}"
        folder.mkdir(parents=True)
        (folder / "signals.mcap").write_bytes(b"12345")
        os.utime(folder / "signals.mcap", ns=(number * 10**9, number * 10**9))
        save_manifest(Manifest(episode_id=folder.name, state="finished"), folder)
    read: list[str] = []
    row = listing._row

    def counted(folder: Path, *, is_live: bool) -> listing.EpisodeRow:
        read.append(folder.name)
        return row(folder, is_live=is_live)

    monkeypatch.setattr(listing, "_row", counted)
    newest = listing.NewestEpisodes(tmp_path, most=3)
    assert [found.episode_id for found in newest.look()] == ["a-0002", "a-0003", "a-0004"]
    assert newest.look() == list_episodes(tmp_path)[-3:]
    read.clear()
    newest.look()
    assert read == []
    changed = Manifest(episode_id="a-0003", state="finished", quality_flags=QualityFlags(discarded=True))
    save_manifest(changed, tmp_path / "walk" / "a-0003")
    assert [found.is_discarded for found in newest.look()] == [False, True, False]
    assert read == ["a-0003"]
    assert listing.NewestEpisodes(tmp_path / "nowhere", most=3).look() == []
