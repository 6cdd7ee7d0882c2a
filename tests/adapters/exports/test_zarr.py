"""The replay buffer of diffusion_policy and UMI: what its loader looks for, on the rows of a LeRobot data set."""

from __future__ import annotations

import gc
import json
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from adapters.exports.kinds import ZARR
from adapters.exports.zarr.kind import ZarrOptions
from station.bus import contracts, keys
from station.errors import StationError
from station.export.kind import Source
from station.export.run import Exported, Workers, export, preview
from tests.adapters.exports.test_hdf5 import lerobot_rows, picture, shown, source_of
from tests.episode.synthetic import ROBOT, EpisodeBuilder, tick
from tests.export.pictured import DEPTH, HEAD, OPTICS, number_in, shoot, walked
from tests.faults.disks import small_disk

pytestmark = pytest.mark.usefixtures("processes")

HERE = Workers(jobs=1)
STATE = keys.robot_state(ROBOT)
STORES = {"folder": "replay_buffer.zarr", "zip": "replay_buffer.zarr.zip"}


def exported(sources: list[Source], out: Path, **options: Any) -> Exported:
    return export(ZARR, sources, ZarrOptions(**{"min_quality": "any", **options}), out, where=HERE)


def opened(out: Path) -> Any:
    """The buffer of a result, as the plain library opens it."""
    file = out / "replay_buffer.zarr.zip"
    store = zarr.storage.ZipStore(file, mode="r") if file.exists() else str(out / "replay_buffer.zarr")
    return zarr.open_group(store, mode="r")


@pytest.mark.parametrize("store", STORES)
def test_rows_of_all_episodes_stand_behind_each_other_and_are_those_of_a_lerobot_data_set(
    tmp_path: Path, store: str
) -> None:
    sources = [walked(tmp_path / "data", number, seconds=0.8 + 0.2 * number, jitter_s=0.002) for number in (1, 2)]
    rows = lerobot_rows(sources, tmp_path / "lerobot", fps=30)
    exported(sources, out := tmp_path / "out", fps=30, store=store)
    assert sorted(path.name for path in out.iterdir()) == ["README.md", STORES[store], "station.json"]
    root = opened(out)
    data, ends = root["data"], root["meta/episode_ends"]
    assert sorted(data.keys()) == ["action", "head", "state", "time_ns"]
    assert (ends.dtype, ends[:].tolist()) == (np.int64, [int(sum(rows["episode_index"] == 0)), len(rows["action"])])
    assert {data[name].shape[0] for name in data} == {ends[:][-1]}, "its loader wants as many rows of each"
    for name in ("state", "action"):
        expected = rows["observation.state" if name == "state" else name].astype(np.float32)
        assert data[name][:].tobytes() == expected.tobytes()
    assert data["time_ns"][:].tolist() == rows["time_ns"].tolist()
    assert (data["head"].dtype, data["head"].shape[1:]) == (np.uint8, (96, 160, 3))
    assert [number_in(one) for one in data["head"][:]] == shown(rows["time_ns"])


def test_depth_is_an_array_of_its_own_in_the_steps_of_the_camera(tmp_path: Path) -> None:
    sources = [walked(tmp_path / "data", number, seconds=0.4, has_depth=True) for number in (1, 2)]
    exported(sources, out := tmp_path / "out", fps=30)
    data = opened(out)["data"]
    found = data["head_depth"]
    assert (found.dtype, found.shape[1:], found.chunks) == (np.uint16, (47, 81), (1, 47, 81))
    assert (found[:, 9, 9] - 1000).tolist() == shown(data["time_ns"][:])
    assert {name: found.attrs[name] for name in ("key", "unit", "step", "no_depth")} == {
        "key": DEPTH, "unit": "m", "step": 0.001, "no_depth": 0,
    }  # fmt: skip
    page = (out / "README.md").read_text()
    assert '"head_depth"]' in page
    assert f"| `data/head_depth` | {DEPTH}, 81x47, depth, uint16, 0.001 m, 0 for none |" in page


def test_the_buffer_says_what_its_numbers_and_episodes_are(tmp_path: Path) -> None:
    success = {"quality_flags": {"success": True}}
    other = {**OPTICS, "mount": OPTICS["mount"] | {"parent": "wall"}}
    stated = [{"servers": {"head": {"key": HEAD, **facts}}, **success} for facts in (OPTICS, other)]
    sources = [
        walked(tmp_path / "data", number, seconds=0.4, manifest=manifest) for number, manifest in enumerate(stated, 1)
    ]
    exported(sources[:1], tmp_path / "first")
    assert {name: opened(tmp_path / "first")["data/head"].attrs[name] for name in OPTICS} == OPTICS
    exported(sources, out := tmp_path / "out")
    root = opened(out)
    assert root.metadata.zarr_format == 2, "diffusion_policy's zarr 2 reads no other"
    assert root.attrs["episode_ids"] == [source.episode_id for source in sources]
    assert (root.attrs["fps"], root.attrs["robot"], root.attrs["success"]) == (50, ROBOT, ["yes", "yes"])
    described = contracts.contract(STATE)
    assert described is not None
    assert root["data/state"].attrs["names"] == list(described.names)
    assert root["data/state"].attrs["units"] == [element.unit for element in described.elements]
    assert set(root["data/state"].attrs["keys"]) == {STATE}
    assert root["data/head"].attrs["rate_hz"] is None
    assert "mount" not in root["data/head"].attrs, "another one in each episode: station.json has them"
    episodes = json.loads((out / "station.json").read_text())["episodes"]
    assert [episode["optics"]["head"] for episode in episodes] == [OPTICS, other]
    assert root["data/head"].chunks == (1, 96, 160, 3), "a row reads one picture"
    page = (out / "README.md").read_text()
    shapes = json.loads(page.split("```json")[1].split("```")[0])
    assert shapes["obs"] == {
        "state": {"shape": [65], "type": "low_dim"},
        "head": {"shape": [3, 96, 160], "type": "rgb"},
    }


def test_a_black_picture_takes_no_place_and_is_black(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    for step in range(20):
        shoot(builder, 0, at_s=0.1 + step / 50, data=picture(np.full((96, 160, 3), 255 * (step % 2))))
        tick(builder, step, at_s=0.11 + step / 50)
    source = source_of(builder.finish({"robot": {"suffix": ROBOT}}))
    exported([source], out := tmp_path / "out", fps=50, store="zip")
    head = opened(out)["data/head"][:]
    means = head.mean(axis=(1, 2, 3)).round().astype(int).tolist()
    assert means in ([[0, 255][(row + first) % 2] for row in range(len(means))] for first in (0, 1))
    with zipfile.ZipFile(out / "replay_buffer.zarr.zip") as archive:
        assert sum(name.startswith("data/head/") for name in archive.namelist()) < len(means)


def test_a_camera_called_as_an_array_has_another_name(tmp_path: Path) -> None:
    builder = EpisodeBuilder(tmp_path / "data")
    for step in range(10):
        builder.write({keys.camera_image("state"): picture(np.zeros((96, 160, 3)))}, at_s=0.1 + step / 50)
        tick(builder, step, at_s=0.11 + step / 50)
    exported([source_of(builder.finish({"robot": {"suffix": ROBOT}}))], out := tmp_path / "out")
    data = opened(out)["data"]
    assert sorted(data.keys()) == ["action", "state", "state_image", "time_ns"]


def test_a_dry_run_names_every_array_and_refuses_what_the_run_refuses(tmp_path: Path) -> None:
    sources = [walked(tmp_path / "data", 1, seconds=0.6), walked(tmp_path / "data", 2, seconds=0.6, camera_hz=0)]
    seen = preview(ZARR, sources, ZarrOptions(min_quality="any"), where=HERE)
    found = exported(sources, tmp_path / "out")
    assert seen.left_out == found.failed
    assert ZARR.columns is not None
    assert [line.partition(":")[0] for line in ZARR.columns(seen.plan)] == [
        "data/state", "data/action", "data/head", "data/time_ns", "meta/episode_ends"
    ]  # fmt: skip


@pytest.mark.parametrize(("library", "told"), [("None", "needs"), ("types.SimpleNamespace(__version__='2.18.7')", "2")])
def test_a_library_that_is_missing_or_too_old_is_named_with_its_cure(tmp_path: Path, library: str, told: str) -> None:
    source = walked(tmp_path / "data", seconds=0.4, camera_hz=0)
    words = ["station", "export", "zarr", source.folder, "--out", str(tmp_path / "out"), "--min-quality", "any"]
    code = (
        f"import sys, types; sys.modules['zarr'] = {library}; sys.argv = {words!r}; "
        "from station.cli.main import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert "teleop-station[zarr]" in done.stderr
    assert ("2.18.7" in done.stderr) == (told == "2")
    assert not (tmp_path / "out").exists()


def test_an_export_that_ran_out_of_disk_leaves_no_output_and_goes_on_from_there(tmp_path: Path) -> None:
    rng, builder = np.random.default_rng(0), EpisodeBuilder(tmp_path / "data")
    for step in range(100):
        shoot(builder, 0, at_s=0.1 + step / 50, data=picture(rng.integers(0, 256, (96, 160, 3))))
        tick(builder, step, at_s=0.11 + step / 50)
    source = source_of(builder.finish({"robot": {"suffix": ROBOT}}))
    (tmp_path / "disk").mkdir()
    with small_disk(tmp_path / "disk", 6) as disk:  # enough for a shard, too little for the whole beside it
        with pytest.raises(StationError, match=r"No space left on device; 1 of 1 episodes are converted and kept"):
            exported([source], disk.path / "out", fps=50)
        gc.collect()  # a file that could not be closed complains here
        assert not (disk.path / "out").exists()
