from __future__ import annotations

from pathlib import Path

from station.episode.listing import list_episodes
from station.episode.manifest import Manifest, QualityFlags, Task, save_manifest
from station.episode.reader import open_episode
from station.episode.show import show
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
    assert (facts.messages, facts.torn, facts.file) == (12, None, "signals.mcap")
    assert facts.first_s is not None
    assert facts.first_s < 0.01
