"""Episodes that are added to a finished data set: as if all had been exported together, and whole at every instant."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from adapters.exports.kinds import LEROBOT
from adapters.exports.lerobot.kind import LeRobotOptions
from station.atomic_file import exchange
from station.errors import EpisodeError, StationError
from station.export import shards
from station.export.kind import Source
from station.export.run import Exported, Workers, export, preview, reopen
from tests.adapters.exports.lerobot.test_lerobot import nearest, pictures
from tests.export.pictured import walked
from tests.killed_at import killed_at

HERE = Workers(jobs=1)
IMAGE = "observation.images.head"

pytestmark = pytest.mark.usefixtures("processes")


def exported(sources: list[Source], out: Path, **options: Any) -> Exported:
    return export(LEROBOT, sources, LeRobotOptions(**{"min_quality": "any", **options}), out, where=HERE)


def appended(sources: list[Source], out: Path, **given: Any) -> Exported:
    options = LeRobotOptions(**{"min_quality": "any", **given})
    return export(LEROBOT, sources, options, out, where=HERE, append=given)


def several(data: Path, *, seconds: float = 0.5, **how: Any) -> list[Source]:
    """Episodes of two tasks, one with marks: the last ones bring names that the first have not."""
    marks = {"marks": [{"at_s": 0.3, "label": "reach"}]}
    return [
        walked(data, 1, seconds=seconds, **how),
        walked(data, 2, seconds=seconds + 0.3, task="squat", **how),
        walked(data, 3, seconds=seconds + 0.1, manifest=marks, **how),
        walked(data, 4, seconds=seconds + 0.2, task="bow", **how),
    ]


def contents(out: Path) -> dict[str, Any]:
    """What a data set says, wherever in which file it stands."""
    told = {path.name: path.read_text() for path in [out / "README.md", *(out / "meta").glob("*.json*")]}
    station = json.loads(told.pop("station.json"))
    episodes: list[dict[str, Any]] = []
    for file in sorted((out / "meta/episodes").rglob("*.parquet")):
        for row in pq.read_table(file).to_pylist():
            episodes.append({k: v for k, v in row.items() if not k.endswith(("_index", "_timestamp")) or "data" in k})
    for row in episodes:
        row.pop("data/chunk_index"), row.pop("data/file_index")
    tables = [pq.read_table(file).to_pydict() for file in sorted((out / "data").rglob("*.parquet"))]
    return {
        **told,
        "station": {name: station[name] for name in station if name != "added"},
        "episodes": episodes,
        "rows": {name: [value for table in tables for value in table[name]] for name in tables[0]},
        "texts": {path.name: pq.read_table(path).to_pydict() for path in (out / "meta").glob("*.parquet")},
        "pictures": [number for file in sorted((out / "videos").rglob("*.mp4")) for number in pictures(file)],
    }


@pytest.mark.parametrize("layout", ["v3.0", "v2.1"])
def test_appending_gives_what_exporting_all_together_gives_to_the_last_bit(tmp_path: Path, layout: str) -> None:
    sources = several(tmp_path / "data")
    exported(sources, together := tmp_path / "together", layout=layout, subtasks="marks")
    exported(sources[:2], out := tmp_path / "set", layout=layout, subtasks="marks")
    done = appended(sources[2:3], out)
    assert (done.had, done.episodes, done.there) == (2, 1, ())
    assert appended(sources[3:], out).had == 3
    found, expected = contents(out), contents(together)
    for name in expected:
        assert found[name] == expected[name], name
    assert len(found["pictures"]) == len(found["rows"]["index"]) == json.loads(found["info.json"])["total_frames"]
    added = json.loads((out / "meta/station.json").read_text())["added"]
    assert [each["from_episode"] for each in added] == [2, 3]


def test_each_row_of_an_appended_set_has_its_own_picture_where_the_episode_says_it_is(tmp_path: Path) -> None:
    sources = several(tmp_path / "data")
    exported(sources[:2], out := tmp_path / "set")
    appended(sources[2:], out)
    tables = [pq.read_table(file) for file in sorted((out / "meta/episodes").rglob("*.parquet"))]
    seen = 0
    for episode in (row for table in tables for row in table.to_pylist()):
        where = {"chunk_index": episode["data/chunk_index"], "file_index": episode["data/file_index"]}
        info = json.loads((out / "meta/info.json").read_text())
        rows = pq.read_table(out / info["data_path"].format(**where)).to_pydict()
        mine = np.array(rows["episode_index"]) == episode["episode_index"]
        where = {name: episode[f"videos/{IMAGE}/{name}"] for name in ("chunk_index", "file_index")}
        shown = pictures(out / info["video_path"].format(video_key=IMAGE, **where))
        first, last = (round(episode[f"videos/{IMAGE}/{end}_timestamp"] * info["fps"]) for end in ("from", "to"))
        assert shown[first:last] == nearest(np.array(rows["time_ns"])[mine].tolist())
        assert np.array(rows["index"])[mine].tolist() == list(
            range(episode["dataset_from_index"], episode["dataset_to_index"])
        )
        seen += episode["length"]
    assert seen == json.loads((out / "meta/info.json").read_text())["total_frames"]


def test_rows_and_videos_that_are_there_stay_the_files_that_they_are_and_so_does_what_others_put_there(
    tmp_path: Path,
) -> None:
    sources = several(tmp_path / "data")[:2]
    exported(sources[:1], out := tmp_path / "set")
    (out / "notes").mkdir()
    (out / "notes/mine.txt").write_text("keep")
    old = {
        path.relative_to(out): path.stat().st_ino for path in out.rglob("*.*") if path.suffix in (".mp4", ".parquet")
    }
    with (out / "meta/info.json").open() as opened:
        appended(sources[1:], out)
        assert json.load(opened)["total_episodes"] == 1, "who has the old one open reads the old one"
    kept = {path for path in old if path.parts[0] != "meta" or path.parts[1] == "episodes"}
    assert {path: (out / path).stat().st_ino for path in kept} == {path: old[path] for path in kept}
    assert (out / "notes/mine.txt").read_text() == "keep"
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_what_is_in_a_set_already_is_not_added_twice_and_is_told(tmp_path: Path) -> None:
    sources = several(tmp_path / "data", camera_hz=0)
    exported(sources[:2], out := tmp_path / "set")
    before = tree(out)
    done = appended(sources[:2], out)
    assert (done.episodes, done.had, done.there) == (0, 2, tuple(source.episode_id for source in sources[:2]))
    assert tree(out) == before
    done = appended(sources[:3], out)
    assert (done.episodes, len(done.there)) == (1, 2)
    assert json.loads((out / "meta/info.json").read_text())["total_episodes"] == 3
    assert list(tmp_path.glob(".*")) == []


def test_another_recording_of_the_same_id_is_refused_and_not_taken_for_it(tmp_path: Path) -> None:
    ours, theirs = (
        walked(tmp_path / lab, 1, seconds=seconds, camera_hz=0) for lab, seconds in (("a", 0.5), ("b", 0.7))
    )
    exported([ours], out := tmp_path / "set")
    before = tree(out)
    with pytest.raises(EpisodeError, match="the data set has another recording of this id"):
        appended([theirs], out)
    done = appended([theirs, walked(tmp_path / "b", 2, seconds=0.5, camera_hz=0)], out)
    assert (done.episodes, [lost.source.episode_id for lost in done.failed]) == (1, [theirs.episode_id])
    assert tree(out) != before


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"fps": 25}, "made with --fps 50, and --fps 25 is asked for"),
        ({"trim": "none"}, "made with --trim waiting, and --trim none is asked for"),
        ({"camera": ("none",)}, "made with --camera head, and --camera none is asked for"),
        ({"layout": "v2.1"}, "made with --layout v3.0, and --layout v2.1 is asked for"),
        ({"action": ("x", "y")}, "made with --action command_used_unitree_g1_with_hands, and --action x,y is asked"),
    ],
)
def test_an_option_that_the_set_was_not_made_with_is_refused_by_name(
    tmp_path: Path, given: dict[str, Any], told: str
) -> None:
    sources = several(tmp_path / "data")
    exported(sources[:1], out := tmp_path / "set", fps=50)
    before = tree(out)
    with pytest.raises(StationError) as refused:
        appended(sources[1:], out, **given)
    assert str(refused.value).startswith(f"{out}: {told}")
    assert "\n" not in str(refused.value)
    assert tree(out) == before
    assert appended(sources[1:2], out, fps=50, trim="waiting", camera=("head",)).episodes == 1


def test_an_episode_that_does_not_fit_the_set_is_refused_by_name_and_the_rest_is_added(tmp_path: Path) -> None:
    sources = several(tmp_path / "data")
    exported(sources[:1], out := tmp_path / "set")
    blind = walked(tmp_path / "data", 9, seconds=0.5, camera_hz=0)
    done = appended([blind, sources[1]], out)
    assert (done.episodes, done.failed[0].reason) == (1, done.failed[0].reason)
    assert f"{blind.episode_id}: no camera 'head' in it" in done.failed[0].reason
    left_out = json.loads((out / "meta/station.json").read_text())["left_out"]
    assert [each["episode_id"] for each in left_out] == [blind.episode_id]


def changed(name: str, key: str, value: Any) -> Callable[[Path], None]:
    def change(out: Path) -> None:
        document = json.loads((out / name).read_text())
        document[key] = value
        (out / name).write_text(json.dumps(document))

    return change


def gone(name: str) -> Callable[[Path], None]:
    return lambda out: (out / name).unlink()


@pytest.mark.parametrize(
    ("harm", "told"),
    [
        (gone("meta/station.json"), "no LeRobot data set of this station, it has no meta/station.json"),
        (changed("meta/station.json", "format", 4), "cannot be added to: its rows are of version 4 of the format"),
        (changed("meta/station.json", "plan", {}), "cannot be added to: meta/station.json or meta/info.json holds"),
        (changed("meta/info.json", "total_episodes", 7), "changed since: total_episodes in meta/info.json is 7"),
        (changed("meta/info.json", "features", {}), "changed since: column 'observation.state' in meta/info.json"),
    ],
)
def test_what_is_no_set_that_this_version_made_is_refused_in_a_line(
    tmp_path: Path, harm: Callable[[Path], None], told: str
) -> None:
    sources = several(tmp_path / "data", camera_hz=0)
    exported(sources[:1], out := tmp_path / "set")
    harm(out)
    with pytest.raises(StationError) as refused:
        appended(sources[1:], out)
    assert str(refused.value).startswith(f"{out}: ")
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_set_of_which_episodes_were_set_aside_is_refused_since_those_are_its_last_ones(tmp_path: Path) -> None:
    sources = several(tmp_path / "data", camera_hz=0)
    exported(sources[:2], out := tmp_path / "set", val=0.5)
    with pytest.raises(StationError, match=r"made with --val 0\.5, so its last episodes are set aside"):
        appended(sources[2:], out)


def test_where_nothing_is_nothing_is_added(tmp_path: Path) -> None:
    with pytest.raises(StationError, match="nothing there to add to; without --append it is made"):
        appended([walked(tmp_path / "data", seconds=0.3, camera_hz=0)], tmp_path / "set")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data"]


def test_a_file_system_that_cannot_exchange_folders_is_told_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sources = several(tmp_path / "data", camera_hz=0)
    exported(sources[:1], out := tmp_path / "set")

    def refuses(*_: Path) -> None:
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr(shards, "exchange", refuses)
    with pytest.raises(StationError, match="does not exchange two folders in one step"):
        appended(sources[1:], out)
    assert list(tmp_path.glob(".*")) == []


def test_a_dry_run_says_what_would_be_added_and_what_is_there(tmp_path: Path) -> None:
    sources = several(tmp_path / "data", camera_hz=0)
    exported(sources[:2], out := tmp_path / "set", fps=25)
    before, options = tree(out), LeRobotOptions(min_quality="any")
    seen = preview(LEROBOT, sources[1:], options, where=HERE, had=reopen(LEROBOT, out, {}))
    assert seen.there == (sources[1].episode_id,)
    assert [source.episode_id for source in seen.sources] == [source.episode_id for source in sources[2:]]
    assert seen.plan.fps == 25
    assert tree(out) == before


def test_the_names_of_two_folders_are_exchanged_at_once(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    for each in (one, other):
        each.mkdir()
        (each / each.name).touch()
    exchange(one, other)
    assert [path.name for path in (*one.iterdir(), *other.iterdir())] == ["other", "one"]
    with pytest.raises(FileNotFoundError):
        exchange(one, tmp_path / "nothing")
    assert [path.name for path in one.iterdir()] == ["other"]


def tree(out: Path) -> dict[str, str]:
    """Every file of a folder, with what is in it."""
    files = (path for path in sorted(out.rglob("*")) if path.is_file())
    return {str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture
def no_waiting_for_the_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a process wrote outlives it also where nothing waited for the disk."""
    monkeypatch.setattr(os, "fsync", lambda _: None)


@pytest.mark.usefixtures("no_waiting_for_the_disk")
def test_killed_at_any_operation_on_files_the_set_is_whole_with_or_without_what_was_to_be_added(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sources = several(tmp_path / "data", seconds=0.3)[:2]
    exported(sources[:1], out := tmp_path / "set")
    before, work = tree(out), tmp_path / ".set.export"
    shutil.copytree(out, tmp_path / "before")
    with monkeypatch.context() as refusing:
        refusing.setattr(shards, "_sync", partial(refuse_joined, shards._sync))
        with pytest.raises(StationError, match="1 of 1 episodes are converted and kept"):
            appended(sources[1:], out)
    assert tree(out) == before
    shutil.copytree(work, tmp_path / "converted")
    assert appended(sources[1:], out).kept == 1
    after, seen, was_killed = tree(out), [], True
    while was_killed:
        shutil.rmtree(work, ignore_errors=True)
        shutil.rmtree(out)
        shutil.copytree(tmp_path / "before", out)
        shutil.copytree(tmp_path / "converted", work)
        was_killed = killed_at(len(seen) + 1, partial(appended, sources[1:], out), within=tmp_path)
        found = tree(out)
        assert found in (before, after), f"killed at operation {len(seen) + 1}"
        seen.append(found == after)
    assert seen == sorted(seen), "first as before, then as after"
    assert (seen[0], seen[-2], len(seen) > 30) == (False, True, True)
    assert not work.exists()


def refuse_joined(sync: Callable[[Path], None], folder: Path) -> None:
    """The disk is full once all is joined."""
    if folder.name == "joined":
        raise OSError(28, "No space left on device", str(folder))
    sync(folder)


@pytest.mark.usefixtures("no_waiting_for_the_disk")
def test_killed_right_after_the_exchange_the_same_command_finds_all_there_and_leaves_nothing_behind(
    tmp_path: Path,
) -> None:
    sources = several(tmp_path / "data", seconds=0.3, camera_hz=0)[:2]
    exported(sources[:1], out := tmp_path / "set")
    before, step = tree(out), 40
    while tree(out) == before:
        assert killed_at(step, partial(appended, sources[1:], out), within=tmp_path)
        step += 1
    assert (tmp_path / ".set.export").exists()
    assert appended(sources[1:], out).there == (sources[1].episode_id,)
    assert not (tmp_path / ".set.export").exists()
