"""Which episodes an export is of."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.errors import EpisodeError, UsageError
from station.export.select import sources
from tests.episode.synthetic import EpisodeBuilder


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Two episodes of one task and one of another."""
    for task, number in (("walk", 1), ("walk", 2), ("wave", 1)):
        builder = EpisodeBuilder(tmp_path / "data", task=task, number=number)
        builder.foreign("own", b"1", at_s=0.1)
        builder.finish()
    return tmp_path / "data"


def ids(data: Path, *episodes: str, tasks: tuple[str, ...] = ()) -> list[str]:
    return [source.episode_id.removeprefix("2026-11-21-g1-") for source in sources(episodes, data, tasks=tasks)]


def test_nothing_named_is_everything_and_a_task_is_its_own(data: Path) -> None:
    assert sorted(ids(data)) == ["walk-0001", "walk-0002", "wave-0001"]
    assert ids(data, tasks=("wave",)) == ["wave-0001"]
    assert sorted(ids(data, tasks=("wave", "walk"))) == ["walk-0001", "walk-0002", "wave-0001"]


def test_ids_beginnings_paths_and_patterns_each_once_in_the_order_in_which_they_are_named(data: Path) -> None:
    path = str(data / "wave" / "2026-11-21-g1-wave-0001")
    assert ids(data, path, "*-walk-*", "2026-11-21-g1-walk-0002") == ["wave-0001", "walk-0001", "walk-0002"]
    assert ids(data, f"{path}/signals.mcap") == ["wave-0001"]
    assert sorted(ids(data, f"{data}/*/*-0001")) == ["walk-0001", "wave-0001"]


@pytest.mark.parametrize("name", ["2026-11-21-g1-run-0001", "*-run-*", "nowhere/*"])
def test_what_is_not_there_is_told(data: Path, name: str) -> None:
    with pytest.raises(EpisodeError):
        sources([name], data)


def test_a_task_without_episodes_is_told(data: Path) -> None:
    with pytest.raises(EpisodeError, match="no episodes of task 'run' in"):
        sources([], data, tasks=["walk", "run"])


def test_two_episodes_of_one_name_are_refused_since_their_files_would_meet(data: Path, tmp_path: Path) -> None:
    other = EpisodeBuilder(tmp_path / "other").finish()
    with pytest.raises(UsageError, match="two episodes are called 2026-11-21-g1-walk-0001"):
        sources(["2026-11-21-g1-walk-0001", str(other)], data)
