from __future__ import annotations

import fcntl
from functools import partial
from pathlib import Path

import pytest

from station.episode.reading.listing import list_episodes
from station.episode.reading.reader import open_episode
from station.episode.storage.bin import bin_folder, clear, delete, find_in_bin, in_bin, size_of, take_back, throw_away
from station.episode.storage.edits import rename_task
from station.episode.storage.folder import find_episodes, new_folder, newest_ids, tasks
from station.episode.storage.left_open import to_repair
from station.episode.storage.manifest import Manifest, save_manifest
from station.errors import EpisodeError
from tests.episode.synthetic import EpisodeBuilder
from tests.killed_at import killed_at


def recorded(data: Path, task: str = "walk", number: int = 1) -> Path:
    builder = EpisodeBuilder(data, task=task, number=number)
    builder.write({"own": b"[1]"}, at_s=0.1)
    return builder.finish()


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_what_is_thrown_away_is_no_episode_of_the_data_folder_and_comes_back_byte_for_byte(tmp_path: Path) -> None:
    first, second = recorded(tmp_path), recorded(tmp_path, number=2)
    before = contents(tmp_path)
    gone = throw_away(first, tmp_path)
    assert gone == tmp_path / ".bin" / "walk" / first.name
    assert find_episodes(tmp_path) == [second]
    assert [row.episode_id for row in list_episodes(tmp_path)] == [second.name]
    assert (tasks(tmp_path), newest_ids(tmp_path, "", 9)) == (["walk"], [second.name])
    with pytest.raises(EpisodeError, match="not found"):
        open_episode(first.name, tmp_path)
    assert [row.episode_id for row in list_episodes(bin_folder(tmp_path))] == [first.name]
    assert take_back(find_in_bin(first.name, tmp_path), tmp_path) == first
    assert contents(tmp_path) == before


def test_no_new_episode_gets_an_id_that_lies_in_the_bin(tmp_path: Path) -> None:
    first = new_folder(tmp_path, "walk", "g1")
    throw_away(first, tmp_path)
    second = new_folder(tmp_path, "walk", "g1")
    assert second.name[-4:] == "0002"
    save_manifest(Manifest(episode_id=second.name, state="finished"), second)
    throw_away(rename_task(second, tmp_path, "jog", "ada"), tmp_path)
    assert new_folder(tmp_path, "walk", "g1").name[-4:] == "0003"


def test_one_that_is_there_already_is_not_overwritten_by_one_that_comes_back(tmp_path: Path) -> None:
    first = recorded(tmp_path)
    throw_away(first, tmp_path)
    recorded(tmp_path)
    with pytest.raises(EpisodeError, match="is there already"):
        take_back(find_in_bin(first.name, tmp_path), tmp_path)
    with pytest.raises(EpisodeError, match="is there already"):
        throw_away(first, tmp_path)
    assert (first / "signals.mcap").is_file()


@pytest.mark.parametrize("name", ["signals.mcap", "cameras.mcap"])
def test_an_episode_that_is_being_written_stays(tmp_path: Path, name: str) -> None:
    folder = recorded(tmp_path)
    with (folder / name).open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(EpisodeError, match="being written just now"):
            throw_away(folder, tmp_path)
    assert folder.is_dir()


def test_one_that_was_left_open_stays_while_a_recorder_may_go_on_with_it(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path)
    builder.write({"own": b"[1]"}, at_s=0.1)
    folder = builder.finish(torn=True)
    with (tmp_path / ".recorder.lock").open("w") as claim:
        fcntl.flock(claim, fcntl.LOCK_EX)
        with pytest.raises(EpisodeError, match="a recorder may still go on"):
            throw_away(folder, tmp_path)
    throw_away(folder, tmp_path)
    assert to_repair(tmp_path) == ([], [])


def test_an_id_that_nothing_has_names_what_comes_close(tmp_path: Path) -> None:
    for number in (1, 2):
        throw_away(recorded(tmp_path, number=number), tmp_path)
    with pytest.raises(EpisodeError, match=r"did you mean .*walk-0002"):
        find_in_bin("2026-11-21-g1-walk-0022", tmp_path)
    with pytest.raises(EpisodeError, match=r"2 in the bin of .* fit"):
        find_in_bin("2026-11-21", tmp_path)


def test_emptying_leaves_nothing_but_what_is_not_ours(tmp_path: Path) -> None:
    kept, gone = recorded(tmp_path), recorded(tmp_path, "jog")
    thrown = throw_away(gone, tmp_path)
    assert size_of(thrown) == sum(map(len, contents(thrown).values()))
    (bin_folder(tmp_path) / "notes.txt").write_text("mine")
    delete(thrown, tmp_path)
    clear(tmp_path)
    assert contents(tmp_path).keys() == {".bin/notes.txt", *(f"walk/{kept.name}/{name}" for name in contents(kept))}
    (bin_folder(tmp_path) / "notes.txt").unlink()
    clear(tmp_path)
    assert not bin_folder(tmp_path).exists()


@pytest.mark.usefixtures("processes")
def test_killed_at_any_step_the_episode_is_whole_in_one_place(tmp_path: Path) -> None:
    folder = recorded(tmp_path)
    whole = contents(folder)
    step = 1
    while killed_at(step, lambda: throw_away(folder, tmp_path)):
        (found,) = [*find_episodes(tmp_path), *in_bin(tmp_path)]
        assert contents(found) == whole
        if found != folder:
            take_back(found, tmp_path)
        step += 1
    assert step > 2
    step = 1
    while killed_at(step, lambda: take_back(in_bin(tmp_path)[0], tmp_path)):
        (found,) = [*find_episodes(tmp_path), *in_bin(tmp_path)]
        assert contents(found) == whole
        if found == folder:
            throw_away(found, tmp_path)
        step += 1
    assert step > 2


@pytest.mark.usefixtures("processes")
def test_an_episode_whose_deletion_was_killed_is_never_half_in_the_bin(tmp_path: Path) -> None:
    step = 1
    while True:
        thrown = throw_away(recorded(tmp_path), tmp_path)
        whole = contents(thrown)
        was_killed = killed_at(step, partial(delete, thrown, tmp_path))
        assert [contents(folder) for folder in in_bin(tmp_path)] in ([], [whole])
        for folder in in_bin(tmp_path):
            delete(folder, tmp_path)
        clear(tmp_path)
        assert not bin_folder(tmp_path).exists()
        if not was_killed:
            break
        step += 1
    assert step > 4
