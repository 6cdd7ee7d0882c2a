from __future__ import annotations

import fcntl
from pathlib import Path

import pytest

from station.episode.storage.edits import MAX_TAGS, change_tags, rename_task, set_success, undo
from station.episode.storage.folder import new_folder, resolve
from station.episode.storage.manifest import Manifest, Task, load_manifest, save_manifest
from station.errors import EpisodeError, UsageError
from tests.episode.synthetic import EpisodeBuilder


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """A finished episode of the task walk."""
    builder = EpisodeBuilder(tmp_path)
    builder.write({"own": b"[1]"}, at_s=0.1)
    return builder.finish({"lab_notes": {"room": 3}})


def test_a_change_is_dated_signed_and_keeps_what_was_there_before(walk: Path, tmp_path: Path) -> None:
    set_success(walk, tmp_path, True, "ada")
    set_success(walk, tmp_path, False, "bob")
    manifest = load_manifest(walk)
    assert manifest.quality_flags.success is False
    assert manifest.foreign["lab_notes"] == {"room": 3}
    assert [(edit.what, edit.by, edit.before, edit.after) for edit in manifest.edits] == [
        ("success", "ada", None, True), ("success", "bob", True, False),
    ]  # fmt: skip
    assert all(edit.at[:2] == "20" for edit in manifest.edits)


def test_what_is_so_already_leaves_no_note(walk: Path, tmp_path: Path) -> None:
    assert set_success(walk, tmp_path, None, "ada") is None
    assert change_tags(walk, tmp_path, [], ["never-there"], "ada") is None
    assert load_manifest(walk).edits == []


def test_tags_are_put_on_and_taken_off(walk: Path, tmp_path: Path) -> None:
    change_tags(walk, tmp_path, ["good", "slow", "good"], [], "ada")
    change_tags(walk, tmp_path, ["日本"], ["slow"], "ada")
    assert load_manifest(walk).tags == ["good", "日本"]


@pytest.mark.parametrize("tag", ["", "a b", "-x", "x" * 41, "a\nb", "a,b"])
def test_what_is_no_tag_is_refused_and_changes_nothing(walk: Path, tmp_path: Path, tag: str) -> None:
    before = (walk / "manifest.yaml").read_bytes()
    with pytest.raises(UsageError, match="expected 1 to 40 letters"):
        change_tags(walk, tmp_path, ["fine", tag], [], "ada")
    assert (walk / "manifest.yaml").read_bytes() == before


def test_there_are_not_any_number_of_tags(walk: Path, tmp_path: Path) -> None:
    change_tags(walk, tmp_path, [f"t{n}" for n in range(MAX_TAGS)], [], "ada")
    with pytest.raises(UsageError, match=f"{MAX_TAGS} are the most"):
        change_tags(walk, tmp_path, ["one-more"], [], "ada")


def test_another_task_moves_the_episode_and_keeps_its_id(walk: Path, tmp_path: Path) -> None:
    moved = rename_task(walk, tmp_path, "Jog Left", "ada")
    assert moved == tmp_path / "jog-left" / walk.name
    assert not walk.parent.exists()
    assert load_manifest(moved).task.name == "Jog Left"
    assert resolve(walk.name, tmp_path) == moved
    assert rename_task(moved, tmp_path, "Jog Left", "ada") == moved


def test_an_id_that_moved_to_another_task_is_not_given_again(tmp_path: Path) -> None:
    first = new_folder(tmp_path, "walk", "g1")
    save_manifest(Manifest(episode_id=first.name, state="finished", task=Task(name="walk")), first)
    rename_task(first, tmp_path, "jog", "ada")
    assert new_folder(tmp_path, "walk", "g1").name != first.name


def test_a_task_that_has_one_of_its_id_refuses_it_and_nothing_changes(walk: Path, tmp_path: Path) -> None:
    (tmp_path / "jog" / walk.name).mkdir(parents=True)
    with pytest.raises(EpisodeError, match="is there already"):
        rename_task(walk, tmp_path, "jog", "ada")
    assert load_manifest(walk).task.name == "walk"


def test_a_rename_that_was_killed_before_it_moved_is_finished_by_the_same_call(walk: Path, tmp_path: Path) -> None:
    manifest = load_manifest(walk)
    manifest.task.name = "jog"
    save_manifest(manifest, walk)
    assert rename_task(walk, tmp_path, "jog", "ada") == tmp_path / "jog" / walk.name


def test_undo_goes_back_change_by_change_and_says_so_in_the_manifest(walk: Path, tmp_path: Path) -> None:
    set_success(walk, tmp_path, True, "ada")
    change_tags(walk, tmp_path, ["good"], [], "ada")
    moved = rename_task(walk, tmp_path, "jog", "ada")
    assert undo(moved, tmp_path, "bob")[1] == walk
    assert load_manifest(walk).task.name == "walk"
    undo(walk, tmp_path, "bob")
    assert load_manifest(walk).tags == []
    undo(walk, tmp_path, "bob")
    manifest = load_manifest(walk)
    assert manifest.quality_flags.success is None
    assert all(edit.undone.endswith(" by bob") for edit in manifest.edits)
    assert len(manifest.edits) == 3
    with pytest.raises(EpisodeError, match="nothing to undo"):
        undo(walk, tmp_path, "bob")


def test_what_somebody_else_changed_since_is_not_undone(walk: Path, tmp_path: Path) -> None:
    set_success(walk, tmp_path, True, "ada")
    manifest = load_manifest(walk)
    manifest.quality_flags.success = False
    save_manifest(manifest, walk)
    with pytest.raises(EpisodeError, match="is False now, not True as ada left it"):
        undo(walk, tmp_path, "bob")


def test_an_episode_that_is_not_finished_keeps_its_manifest(walk: Path, tmp_path: Path) -> None:
    manifest = load_manifest(walk)
    manifest.state = "recording"
    save_manifest(manifest, walk)
    with pytest.raises(EpisodeError, match="not finished"):
        set_success(walk, tmp_path, True, "ada")


def test_an_episode_that_is_being_written_keeps_its_manifest(walk: Path, tmp_path: Path) -> None:
    set_success(walk, tmp_path, False, "ada")
    with (walk / "signals.mcap").open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(EpisodeError, match="being written just now"):
            set_success(walk, tmp_path, True, "ada")
        with pytest.raises(EpisodeError, match="being written just now"):
            undo(walk, tmp_path, "ada")
