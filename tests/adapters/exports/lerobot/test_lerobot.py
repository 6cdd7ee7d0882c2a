"""LeRobot data sets: files, types and names as LeRobot wants them, and pictures that belong to their rows."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from pathlib import Path
from typing import Any

import av
import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from adapters.commands.twist2 import FORMAT
from adapters.exports.kinds import LEROBOT
from adapters.exports.lerobot.dataset import groups
from adapters.exports.lerobot.features import INDEX
from adapters.exports.lerobot.kind import LeRobotOptions
from adapters.exports.lerobot.plan import Camera
from adapters.exports.lerobot.video import packets
from adapters.robots.kassow.names import KR810_ROBOT
from station.bus import codec, contracts, keys
from station.contract import names_of
from station.errors import EpisodeError
from station.export import shards
from station.export.kind import Source
from station.export.run import Exported, Workers, export, preview
from tests.episode.arm_run import ArmRun
from tests.episode.synthetic import ROBOT, EpisodeBuilder, tick
from tests.export.pictured import HEAD, number_in, shoot, walked

pytestmark = pytest.mark.usefixtures("processes")

IMAGE = "observation.images.head"
AGE = "age_s.camera.head"


def exported(sources: list[Source], out: Path, **options: Any) -> Exported:
    wish = LeRobotOptions(**{"min_quality": "any", **options})
    return export(LEROBOT, sources, wish, out, where=Workers(jobs=1))


def two(data: Path) -> list[Source]:
    return [walked(data, 1, seconds=1.0), walked(data, 2, seconds=1.2)]


def pictures(file: Path) -> list[int]:
    with av.open(str(file)) as video:
        return [number_in(frame.to_ndarray(format="rgb24")) for frame in video.decode(video=0)]


def nearest(time_ns: list[int], first_taken_s: float = 0.083, hz: float = 30.0) -> list[int]:
    start = 1_795_000_000_000_000_000
    seconds = (np.array(time_ns) - start) * 1e-9
    return np.round((seconds - first_taken_s) * hz).astype(int).tolist()


def test_v30_has_the_files_types_and_names_that_lerobot_reads(tmp_path: Path) -> None:
    exported(two(tmp_path / "data"), out := tmp_path / "set")
    info = json.loads((out / "meta/info.json").read_text())
    assert {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()} == {
        "README.md", "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet", "meta/info.json",
        "meta/modality.json", "meta/names.json", "meta/pixel_counts.json", "meta/splits.json", "meta/station.json",
        "meta/stats.json",
        "meta/tasks.parquet",
        f"videos/{IMAGE}/chunk-000/file-000.mp4",
    }  # fmt: skip
    data = pq.ParquetFile(out / "data/chunk-000/file-000.parquet")
    assert data.num_row_groups == 2
    types = {field.name: str(field.type) for field in data.schema_arrow}
    assert types == {
        "observation.state": "fixed_size_list<element: float>[65]", "action": "fixed_size_list<element: float>[35]",
        "age_s.observation.state": "float", "age_s.action": "float", AGE: "float", "time_ns": "int64",
        "gate": "int64", "commander": "int64",
        "timestamp": "float", "frame_index": "int64", "episode_index": "int64", "index": "int64", "task_index": "int64",
    }  # fmt: skip
    assert set(info["features"]) == {*types, IMAGE}
    state = contracts.contract(keys.robot_state(ROBOT))
    assert state is not None
    assert info["features"]["observation.state"] == {"dtype": "float32", "shape": [65], "names": list(state.names)}
    assert info["features"][IMAGE]["shape"] == [96, 160, 3]
    rows = data.read().to_pydict()
    assert (info["total_episodes"], info["total_frames"], info["splits"]) == (2, len(rows["index"]), {"train": "0:2"})
    assert rows["index"] == list(range(len(rows["index"])))
    assert np.allclose(rows["timestamp"], np.array(rows["frame_index"]) / 50, atol=1e-5)


def test_each_row_of_v30_has_its_own_picture_also_behind_another_episode(tmp_path: Path) -> None:
    exported(two(tmp_path / "data"), out := tmp_path / "set")
    rows = pq.read_table(out / "data/chunk-000/file-000.parquet").to_pydict()
    shown = pictures(out / f"videos/{IMAGE}/chunk-000/file-000.mp4")
    assert shown == nearest(rows["time_ns"])
    episodes = pq.read_table(out / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for episode in episodes:
        assert episode[f"videos/{IMAGE}/from_timestamp"] == pytest.approx(episode["dataset_from_index"] / 50)
        assert episode[f"videos/{IMAGE}/to_timestamp"] == pytest.approx(episode["dataset_to_index"] / 50)
        assert episode["length"] == episode["dataset_to_index"] - episode["dataset_from_index"]
        assert episode["tasks"] == ["walk"]
    state, action = np.array(rows["observation.state"]), np.array(rows["action"])
    assert np.allclose(action[:, 6] - state[:, 0], 0.5, atol=1e-5)


@pytest.mark.parametrize("layout", ["v3.0", "v2.1"])
def test_statistics_are_those_of_the_rows(tmp_path: Path, layout: str) -> None:
    exported(two(tmp_path / "data"), out := tmp_path / "set", layout=layout)
    files = sorted((out / "data").rglob("*.parquet"))
    rows = np.concatenate([np.array(pq.read_table(file).to_pydict()["observation.state"]) for file in files])
    found = json.loads((out / "meta/stats.json").read_text())
    state = found["observation.state"]
    assert state.get("count") == ([len(rows)] if layout == "v3.0" else None)
    for name, expected in (("mean", rows.mean(0)), ("std", rows.std(0)), ("min", rows.min(0)), ("max", rows.max(0))):
        assert np.allclose(state[name], expected, atol=1e-6), name
    spread = rows.max(0) - rows.min(0)
    for name, share in (("q01", 0.01), ("q10", 0.1), ("q50", 0.5), ("q90", 0.9), ("q99", 0.99)):
        lower, higher = (np.quantile(rows, share, axis=0, method=method) for method in ("lower", "higher"))
        assert (state[name] >= lower - 0.03 * spread - 1e-9).all(), name
        assert (state[name] <= higher + 0.03 * spread + 1e-9).all(), name
    assert np.array(found[IMAGE]["mean"]).shape == (3, 1, 1)
    assert 0.2 < found[IMAGE]["mean"][0][0][0] < 0.5
    assert set(found) == set(json.loads((out / "meta/info.json").read_text())["features"])


def test_v21_has_a_file_and_a_video_per_episode_and_what_groot_asks_for(tmp_path: Path) -> None:
    exported(two(tmp_path / "data"), out := tmp_path / "set", layout="v2.1")
    info = json.loads((out / "meta/info.json").read_text())
    assert (info["codebase_version"], info["total_videos"], info["total_chunks"]) == ("v2.1", 2, 1)
    lines = [json.loads(line) for line in (out / "meta/episodes.jsonl").read_text().splitlines()]
    for number, line in enumerate(lines):
        where = {"episode_chunk": 0, "episode_index": number, "video_key": IMAGE}
        rows = pq.read_table(out / info["data_path"].format(**where)).to_pydict()
        assert len(rows["index"]) == line["length"]
        assert pictures(out / info["video_path"].format(**where)) == nearest(rows["time_ns"])
    assert [json.loads(line)["task"] for line in (out / "meta/tasks.jsonl").read_text().splitlines()] == ["walk"]
    modality = json.loads((out / "meta/modality.json").read_text())
    assert modality["state"]["left_arm"] == {"start": 15, "end": 22}
    assert modality["action"]["root"] == {"start": 0, "end": 6}
    assert modality["video"] == {"head": {"original_key": IMAGE}}


def test_whatever_has_image_in_its_name_has_the_statistics_of_pictures_or_lerobot_refuses_the_set(
    tmp_path: Path,
) -> None:
    exported(two(tmp_path / "data"), out := tmp_path / "set", layout="v2.1")
    lines = [json.loads(line) for line in (out / "meta/episodes_stats.jsonl").read_text().splitlines()]
    assert [line["episode_index"] for line in lines] == [0, 1]
    for line in lines:
        assert set(line["stats"]) == set(json.loads((out / "meta/info.json").read_text())["features"])
        for column, found in line["stats"].items():
            shapes = {name: np.array(values).shape for name, values in found.items()}
            assert shapes.pop("count") == (1,)
            assert set(shapes.values()) == {(3, 1, 1)} or "image" not in column, column
    named = Camera(name="image_left", key="k", height=2, width=2)
    assert "image" not in named.age_column


def test_groot_can_cut_every_statistic_into_the_parts_of_the_body(tmp_path: Path) -> None:
    exported(two(tmp_path / "data"), out := tmp_path / "set", layout="v2.1")
    modality, found = (json.loads((out / f"meta/{name}.json").read_text()) for name in ("modality", "stats"))
    for part, column in (("state", "observation.state"), ("action", "action")):
        assert {"min", "max", "mean", "std", "q01", "q99"} <= set(found[column])
        ends = max(span["end"] for span in modality[part].values())
        assert {len(values) for values in found[column].values()} == {ends}


def test_cameras_that_only_later_episodes_have_are_told_of_unless_others_were_asked_for(tmp_path: Path) -> None:
    blind = walked(tmp_path / "data", 1, seconds=0.5, camera_hz=0)
    sources = [blind, walked(tmp_path / "data", 2, seconds=0.5)]
    (note,) = exported(sources, tmp_path / "a").facts["notes"]
    assert note.startswith("1 of 2 episodes (2026-11-21-g1-walk-0002 first) have cameras that the first one has not")
    assert "not in the data set: head; with --camera" in note
    assert exported(sources, tmp_path / "b", camera=("none",)).facts["notes"] == []


def test_episodes_that_are_cut_at_their_ends_are_told_with_how_much(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    for number in range(150):
        tick(builder, number, at_s=0.02 * number)
    for number in range(45):
        shoot(builder, number, at_s=0.03 + number / 30)  # and gone at half
    folder = builder.finish({"robot": {"suffix": ROBOT}})
    whole = walked(tmp_path / "data", 2, seconds=1.0)
    sources = [Source(episode_id=folder.name, folder=str(folder)), whole]
    (note,) = exported(sources, tmp_path / "set").facts["notes"]
    assert note.startswith("1 of 2 episodes have rows for a part of what was recorded only")
    assert f"cut are {folder.name} 1.5 s (0.0 at its beginning, 1.5 at its end); `station check` says" in note
    assert exported([whole], tmp_path / "alone").facts["notes"] == []


def test_rows_without_an_action_of_their_own_are_told_and_hashes_are_those_of_the_recording(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    for number in range(50):
        if number in (20, 21):
            builder.write({keys.robot_state(ROBOT): codec.f64(np.zeros(65))}, at_s=0.02 * number)
        else:
            tick(builder, number, at_s=0.02 * number)
    folder = builder.finish({"robot": {"suffix": ROBOT}})
    (folder / "enriched.mcap").write_bytes(b"made of it, and made anew at will")
    source = Source(episode_id=folder.name, folder=str(folder))
    (note,) = exported([source], out := tmp_path / "set").facts["notes"]
    assert note.startswith(f"2 rows in 1 of 1 episodes ({folder.name} first) hold the action of a neighbouring step")
    assert "2 rows with the action of a neighbouring step" in (out / "README.md").read_text()
    (episode,) = json.loads((out / "meta/station.json").read_text())["episodes"]
    digest = hashlib.sha256((folder / "signals.mcap").read_bytes()).hexdigest()
    assert episode["sha256"] == {"signals.mcap": digest}


def test_every_column_is_told_of_before_anything_is_written(tmp_path: Path) -> None:
    sources = two(tmp_path / "data")
    seen = preview(LEROBOT, sources, LeRobotOptions(min_quality="any"), where=Workers(jobs=1))
    assert LEROBOT.columns is not None
    told = "\n".join(LEROBOT.columns(seen.plan))
    exported(sources, out := tmp_path / "set")
    features = set(json.loads((out / "meta/info.json").read_text())["features"]) - set(INDEX)
    assert {name for name in features if name not in told} == set()
    assert f"{IMAGE}: {HEAD}, 160x96" in told


def test_groups_of_every_contract_cover_it_without_a_gap() -> None:
    for contract in contracts.contracts():
        spans = list(groups(contract.names).values())
        assert [span["start"] for span in spans] == [0, *(span["end"] for span in spans)][: len(spans)]
        assert not spans or spans[-1]["end"] == len(contract.names)
    assert set(groups(names_of(FORMAT.elements))) == {
        "root", "left_leg", "right_leg", "waist", "left_arm", "right_arm",
    }  # fmt: skip
    arm = contracts.contract(keys.state_joints(KR810_ROBOT))
    assert arm is not None
    assert set(groups(arm.names)) == {"joint", "joint_vel", "joint_torque"}


@pytest.mark.parametrize(("layout", "version"), [("v3.0", "v3"), ("v2.1", "v2")])
def test_reruns_reader_streams_every_episode_with_curves_named_as_the_contract_names_them(
    tmp_path: Path, layout: str, version: str
) -> None:
    experimental = pytest.importorskip("rerun.experimental")
    if not hasattr(experimental, "LeRobotReader"):
        pytest.skip("this rerun-sdk has no reader of LeRobot data sets")
    exported(two(tmp_path / "data"), out := tmp_path / "set", layout=layout)
    reader = experimental.LeRobotReader(out)
    assert (reader.version, reader.episodes()) == (version, [0, 1])
    rows = [len(pictures(file)) for file in sorted((out / "videos").rglob("*.mp4"))]
    state = contracts.contract(keys.robot_state(ROBOT))
    assert state is not None
    seen = Counter[str]()
    for episode in reader.episodes():
        for chunk in reader.stream(episode):
            batch = chunk.to_record_batch()
            if chunk.is_static and str(chunk.entity_path) == "/observation.state":
                assert batch.to_pydict()["SeriesLines:names"] == [list(state.names)]
            seen.update({f"{chunk.entity_path} {name}": chunk.num_rows for name in batch.schema.names})
    assert seen["/observation.state Scalars:scalars"] == seen["/action Scalars:scalars"] == sum(rows)
    assert seen[f"/{IMAGE} VideoStream:sample"] == sum(rows)


@pytest.mark.parametrize("coding", ["h264", "av1"])
@pytest.mark.parametrize("gop", [1, 2, 7, 30])
def test_each_episode_begins_with_a_key_frame_and_has_one_every_so_many_also_behind_another_episode(
    tmp_path: Path, coding: str, gop: int
) -> None:
    sources = [walked(tmp_path / "data", 1, seconds=0.7), walked(tmp_path / "data", 2, seconds=0.9)]
    exported(sources, out := tmp_path / "set", codec=coding, gop=gop)
    rows = pq.read_table(out / "data/chunk-000/file-000.parquet").to_pydict()
    video = out / f"videos/{IMAGE}/chunk-000/file-000.mp4"
    assert pictures(video) == nearest(rows["time_ns"])
    is_key = [packet.is_keyframe for packet in packets(video)]
    assert is_key == [number % gop == 0 for number in rows["frame_index"]]
    assert rows["episode_index"][-1] == 1
    told = "every frame a key frame" if gop == 1 else f"a key frame every {gop} frames"
    assert told in (out / "README.md").read_text()


@pytest.mark.parametrize("gop", [2, 30])
def test_a_video_of_one_episode_has_the_key_frames_that_were_asked_for(tmp_path: Path, gop: int) -> None:
    exported([walked(tmp_path / "data", seconds=0.9)], out := tmp_path / "set", layout="v2.1", gop=gop)
    is_key = [packet.is_keyframe for packet in packets(next((out / "videos").rglob("*.mp4")))]
    assert is_key == [number % gop == 0 for number in range(len(is_key))]


def test_the_usual_distance_of_key_frames_is_thirty(tmp_path: Path) -> None:
    exported([walked(tmp_path / "data", seconds=0.9)], out := tmp_path / "set")
    is_key = [packet.is_keyframe for packet in packets(out / f"videos/{IMAGE}/chunk-000/file-000.mp4")]
    assert np.flatnonzero(is_key).tolist() == list(range(0, len(is_key), 30))
    with pytest.raises(ValueError, match="1"):
        msgspec.convert({"gop": 0}, LeRobotOptions)


def test_a_picture_that_cannot_be_read_is_replaced_and_its_age_says_so(tmp_path: Path) -> None:
    source = walked(tmp_path / "data", bad_pictures=(20,))
    exported([source], out := tmp_path / "set")
    rows = pq.read_table(out / "data/chunk-000/file-000.parquet").to_pydict()
    shown = pictures(out / f"videos/{IMAGE}/chunk-000/file-000.mp4")
    assert 20 not in shown
    ages = np.array(rows["time_ns"]) * 1e-9 - (1_795_000_000 + 0.083 + np.array(shown) / 30)
    assert np.allclose(ages, rows[AGE], atol=1e-5)
    assert "1 could not be read" in (out / "README.md").read_text()


def test_what_does_not_fit_is_left_out_by_name_and_the_rest_is_exported(tmp_path: Path) -> None:
    data = tmp_path / "data"
    good, blind = walked(data, 1, seconds=0.6), walked(data, 2, seconds=0.6, camera_hz=0)
    poor = walked(data, 3, seconds=0.6, manifest={"quality_flags": {"discarded": True}})
    found = exported([good, blind, poor], out := tmp_path / "set", min_quality="usable")
    assert found.episodes == 1
    assert [each.source for each in found.left_out] == [poor]
    assert [each.source for each in found.failed] == [blind]
    assert f"{blind.episode_id}: no camera 'head' in it" in found.failed[0].reason
    card = (out / "README.md").read_text()
    assert "discarded" in card
    assert "no camera 'head'" in card


def test_an_episode_of_no_length_is_refused_by_name(tmp_path: Path) -> None:
    source = walked(tmp_path / "data", seconds=0.0, camera_hz=0)
    with pytest.raises(EpisodeError, match=source.episode_id):
        exported([source], tmp_path / "set", state=(keys.robot_state(ROBOT),), action=(keys.command_used(ROBOT),))
    assert not (tmp_path / "set").exists()


def test_the_same_seed_sets_the_same_episodes_aside_and_they_come_last(tmp_path: Path) -> None:
    sources = [walked(tmp_path / "data", number, seconds=0.3, camera_hz=0) for number in range(1, 6)]
    splits = []
    for name in ("one", "two"):
        exported(sources, out := tmp_path / name, val=0.4, seed=3)
        splits.append(json.loads((out / "meta/splits.json").read_text())["episodes"])
        assert json.loads((out / "meta/info.json").read_text())["splits"] == {"train": "0:3", "val": "3:5"}
    assert splits[0] == splits[1]
    assert len(splits[0]["val"]) == 2
    assert (tmp_path / "one/data/chunk-000/file-000.parquet").read_bytes() == (
        tmp_path / "two/data/chunk-000/file-000.parquet"
    ).read_bytes()


def test_an_export_that_broke_off_goes_on_with_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sources, out = two(tmp_path / "data"), tmp_path / "set"
    options = LeRobotOptions(min_quality="any")
    plan = LEROBOT.prepare(sources, options)
    with shards.open_work(out) as work:
        first = shards.make_shard(
            shards.Task(format="lerobot", source=sources[0], plan=plan, min_quality="any", work=str(work))
        )
    assert first.status == "made"
    assert not out.exists()
    found = exported(sources, out)
    assert (found.episodes, found.kept) == (2, 1)
    assert not (tmp_path / ".set.export").exists()


def test_a_shard_is_kept_only_while_the_rules_are_those_that_let_it_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    source = walked(tmp_path / "data", seconds=0.3, camera_hz=0)
    plan = LEROBOT.prepare([source], LeRobotOptions(min_quality="usable"))
    lab = tmp_path / "station" / "quality.yaml"
    lab.parent.mkdir()
    found = []
    with shards.open_work(tmp_path / "set") as work:
        for text in ("gap: off", "gap: off", "slow: off"):
            lab.write_text(text)
            task = shards.Task(format="lerobot", source=source, plan=plan, min_quality="usable", work=str(work))
            found.append(shards.make_shard(task).status)
    assert found == ["made", "kept", "made"]


def test_an_episode_that_changes_while_it_is_read_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sources, out = two(tmp_path / "data"), tmp_path / "set"
    manifest = Path(sources[1].folder) / "manifest.yaml"
    plan = LEROBOT.prepare(sources, LeRobotOptions(min_quality="any"))
    fingerprint = shards._fingerprint

    def and_then_it_changes(kind: Any, task: shards.Task) -> str:
        found = fingerprint(kind, task)
        with manifest.open("a") as file:
            file.write("# again\n")
        return found

    monkeypatch.setattr(shards, "_fingerprint", and_then_it_changes)
    with shards.open_work(out) as work:
        task = shards.Task(format="lerobot", source=sources[1], plan=plan, min_quality="any", work=str(work))
        outcome = shards.make_shard(task)
    assert outcome.status == "failed"
    assert "changed while it was read" in outcome.reason


def test_a_folder_that_is_not_empty_is_refused(tmp_path: Path) -> None:
    (out := tmp_path / "set").mkdir()
    (out / "mine").write_text("keep")
    with pytest.raises(Exception, match="not empty"):
        exported([walked(tmp_path / "data", seconds=0.3, camera_hz=0)], out)
    assert (out / "mine").read_text() == "keep"


def test_a_camera_can_be_left_out(tmp_path: Path) -> None:
    exported([walked(tmp_path / "data", seconds=0.3)], out := tmp_path / "set", camera=("none",))
    assert not (out / "videos").exists()
    assert json.loads((out / "meta/info.json").read_text())["video_path"] is None
    assert HEAD not in (out / "meta/info.json").read_text()


def test_an_arm_needs_no_keys_named(tmp_path: Path) -> None:
    made = ArmRun(EpisodeBuilder(tmp_path / "data", task="jog"))
    made.hold(0.5)
    made.move(2.0)
    folder = made.finish()
    exported([Source(episode_id=folder.name, folder=str(folder))], out := tmp_path / "set")
    table = pq.read_table(out / "data/chunk-000/file-000.parquet")
    state, action = np.array(table["observation.state"].to_pylist()), np.array(table["action"].to_pylist())
    assert (state.shape[1], action.shape[1]) == (21, 7)
    assert action[-1, 0] - action[0, 0] > 0.4  # joint 1 moved at 0.3 rad/s
    ahead = action[:, 0] - state[:, 0]  # what was made of the state of the same row
    assert ahead.min() >= 0.0
    assert ahead.max() < 0.02
