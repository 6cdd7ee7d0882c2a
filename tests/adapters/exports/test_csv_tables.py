from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from adapters.exports.csv_tables import CONTENTS, file_names
from adapters.exports.named_rows import in_seconds
from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.bus.contracts import contract
from station.episode.reading.reader import open_episode
from station.errors import EpisodeError, UsageError
from tests.adapters.exports.quick_looks import converted
from tests.enrich.recordings import walked
from tests.episode.synthetic import ROBOT, WALL_START_NS, EpisodeBuilder

STATE, COMMAND = keys.robot_state(ROBOT), twist_keys.action_body()


def rows(path: Path) -> list[list[str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def test_each_key_is_a_table_with_exact_times_and_numbers_under_names_with_units(tmp_path: Path) -> None:
    episode = walked(tmp_path / "data")
    made = converted("csv", episode, tmp_path / "out")
    place, reader = tmp_path / "out" / episode.name, open_episode(episode)
    for key in (STATE, COMMAND, keys.operator_head("pico")):
        title, *found = rows(place / f"{key}.csv")
        described = contract(key)
        assert described is not None
        units = [f"{e.name} [{e.unit}]" if e.unit else e.name for e in described.elements]
        assert title == ["log_time_s", "publish_time_s", "sequence", *units]
        recorded, messages = reader.vectors(key), list(reader.messages([key]))
        assert np.array_equal(np.array(found, dtype=float)[:, 3:], recorded.values)
        exact = [(round(float(row[0]) * 1e9), round(float(row[1]) * 1e9), int(row[2])) for row in found]
        kept = [m for m in messages if not m.channel.is_deletion]
        assert exact == [(m.log_ns - WALL_START_NS, m.publish_ns - WALL_START_NS, m.sequence) for m in kept]
    assert made.rows == sum(len(rows(path)) - 1 for path in place.glob("*.csv"))
    assert made.seconds == pytest.approx(0.9875)


def test_the_contents_say_what_is_where_and_what_was_left_out(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    builder.write({STATE: codec.f64([0.0] * 65)}, at_s=0.1)
    builder.write({STATE: codec.f64([0.0] * 64)}, at_s=0.2)
    builder.foreign("strange", b"[1, 2]", at_s=0.3)
    episode = builder.finish()
    made = converted("csv", episode, tmp_path / "out")
    contents = json.loads((tmp_path / "out" / episode.name / CONTENTS).read_text())
    assert (contents["task"], contents["instruction"], contents["start_ns"]) == ("walk", "walk", WALL_START_NS)
    assert contents["keys"][STATE]["file"] == f"{STATE}.csv"
    assert (contents["keys"][STATE]["rows"], contents["keys"][STATE]["unfit"]) == (1, 1)
    assert contents["left_out"] == made.facts["left_out"] == ["strange"]


def test_the_contents_tell_the_note_of_a_key_that_was_deleted_too(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    builder.write({STATE: codec.f64([0.0] * 65)}, at_s=0.1)
    builder.delete(STATE, at_s=0.2)
    episode, described = builder.finish(), contract(STATE)
    converted("csv", episode, tmp_path / "out", STATE)
    contents = json.loads((tmp_path / "out" / episode.name / CONTENTS).read_text())
    assert described is not None
    assert contents["keys"][STATE]["note"] == described.note != ""


def test_only_the_keys_that_are_asked_for_are_exported(tmp_path: Path) -> None:
    episode = walked(tmp_path / "data")
    converted("csv", episode, tmp_path / "out", COMMAND)
    assert [path.name for path in (tmp_path / "out" / episode.name).glob("*.csv")] == [f"{COMMAND}.csv"]


@pytest.mark.parametrize("name", ["csv", "npz", "parquet", "jointstate-mcap"])
def test_a_key_without_names_is_refused_by_its_name(tmp_path: Path, name: str) -> None:
    episode = walked(tmp_path / "data", seconds=0.2)
    with pytest.raises(UsageError, match=f"--keys {keys.policy_obs(ROBOT)}: has no names.*leave it out"):
        converted(name, episode, tmp_path / "one", keys.policy_obs(ROBOT))
    with pytest.raises(UsageError, match=f"--keys {keys.EVENT}: holds json"):
        converted(name, episode, tmp_path / "two", keys.EVENT)
    with pytest.raises(EpisodeError, match=f"{episode.name}: key 'strange' has no contract"):
        converted(name, episode, tmp_path / "three", "strange")
    with pytest.raises(EpisodeError, match=f"{episode.name}: no key 'robot_stat' in it.*did you mean"):
        converted(name, episode, tmp_path / "four", "robot_stat")


@pytest.mark.parametrize("name", ["csv", "npz", "parquet", "jointstate-mcap"])
def test_an_episode_without_any_named_number_is_refused_by_its_name(tmp_path: Path, name: str) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    builder.foreign("strange", b"[1, 2]", at_s=0.1)
    with pytest.raises(EpisodeError, match=f"{builder.episode_id}: no key in it whose numbers have names"):
        converted(name, builder.finish(), tmp_path / "out")


def test_names_of_files_differ_whatever_the_keys_are() -> None:
    names = file_names(["a/b", "a:b", "a.b", "..", "x" * 300, "é"])
    assert names["a/b"] == "a_b.csv"
    assert len(set(names.values())) == len(names)
    assert all("/" not in name and not name.startswith(".") and len(name.encode()) < 200 for name in names.values())


@pytest.mark.parametrize(
    ("time_ns", "text"),
    [(0, "0.000000000"), (1_500_000_001, "1.500000001"), (-1, "-0.000000001"), (-2_000_000_000, "-2.000000000")],
)
def test_times_are_exact_before_and_after_the_start(time_ns: int, text: str) -> None:
    assert in_seconds(time_ns) == text
