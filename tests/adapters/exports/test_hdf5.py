"""HDF5 for robomimic and ACT: the layouts that their loaders read, on the rows of a LeRobot data set."""

from __future__ import annotations

import gc
import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from adapters.exports.hdf5.kind import Hdf5Options
from adapters.exports.kinds import HDF5, LEROBOT
from adapters.exports.lerobot.kind import LeRobotOptions
from station.bus import contracts, keys
from station.errors import EpisodeError, StationError, UsageError
from station.export.kind import Source
from station.export.run import Exported, Workers, export, preview
from tests.episode.arm_run import ArmRun
from tests.episode.synthetic import ROBOT, EpisodeBuilder, tick
from tests.export.pictured import DEPTH, HEAD, OPTICS, jpeg, number_in, shoot, walked
from tests.faults.disks import small_disk

pytestmark = pytest.mark.usefixtures("processes")

HERE = Workers(jobs=1)
STATE = keys.robot_state(ROBOT)
LAYOUTS = ("robomimic", "act")


def exported(sources: list[Source], out: Path, **options: Any) -> Exported:
    return export(HDF5, sources, Hdf5Options(**{"min_quality": "any", **options}), out, where=HERE)


def lerobot_rows(sources: list[Source], out: Path, **options: Any) -> dict[str, Any]:
    """The columns of a LeRobot data set, shape (n, …)."""
    export(LEROBOT, sources, LeRobotOptions(min_quality="any", **options), out, where=HERE)
    table = pq.read_table(out / "data/chunk-000/file-000.parquet").to_pydict()
    return {name: np.array(table[name]) for name in ("observation.state", "action", "time_ns", "episode_index")}


def source_of(folder: Path) -> Source:
    return Source(episode_id=folder.name, folder=str(folder))


def picture(rgb: Any) -> bytes:
    """A JPEG of pixels, shape (height, width, 3)."""
    stream = io.BytesIO()
    Image.fromarray(rgb.astype(np.uint8)).save(stream, "JPEG", quality=90)
    return stream.getvalue()


def shown(time_ns: Any) -> list[int]:
    """The numbers of the pictures nearest to some instants."""
    return np.round(((np.asarray(time_ns) - 1_795_000_000_000_000_000) * 1e-9 - 0.083) * 30).astype(int).tolist()


def decoded(row: Any) -> Any:
    return np.array(Image.open(io.BytesIO(row.tobytes())))


@pytest.mark.parametrize(
    ("layout", "path", "shape"),
    [("robomimic", "obs/head_depth", (47, 81, 1)), ("act", "observations/images_depth/head", (47, 81))],
)
def test_depth_stands_beside_pictures_in_the_steps_of_the_camera(
    tmp_path: Path, layout: str, path: str, shape: tuple[int, ...]
) -> None:
    facts = {"servers": {"head": {"key": HEAD, **OPTICS, "depth": {"key": DEPTH, "step_m": 0.001}}}}
    source = walked(tmp_path / "data", seconds=0.6, has_depth=True, manifest=facts)
    done = exported([source], out := tmp_path / "out", fps=30, layout=layout)
    with h5py.File(out / ("dataset.hdf5" if layout == "robomimic" else "episode_0.hdf5")) as file:
        group = file["data/demo_0"] if layout == "robomimic" else file
        found = group[path]
        assert (found.dtype, found.shape[1:]) == (np.uint16, shape)
        assert found[:, 0].max() == 0, "no depth stays none"
        assert (found[:, 9, 9].ravel() - 1000).tolist() == shown(group["time_ns"])
        assert (found.attrs["unit"], found.attrs["step"], found.attrs["no_depth"]) == ("m", 0.001, 0)
        assert json.loads(found.attrs["intrinsics"]) == OPTICS["intrinsics"]
        if layout == "act":
            assert group["compress_len"].shape == (1, len(found)), "of pictures in colour alone"
    page = (out / "README.md").read_text()
    assert f"| `{path}` | {DEPTH}, 81x47, depth, uint16, 0.001 m, 0: none |" in page
    if layout == "robomimic":
        config = json.loads(page.split("```json")[1].split("```")[0])
        assert config["observation"]["modalities"]["obs"]["depth"] == ["head_depth"]
    assert done.facts["cameras"] == ["head", "head_depth"]


def test_who_wants_one_camera_gets_its_depth_and_who_wants_none_gets_none(tmp_path: Path) -> None:
    source = walked(tmp_path / "data", seconds=0.4, has_depth=True)
    for number, (camera, found) in enumerate(((("head",), ["head", "head_depth"]), (("none",), []))):
        assert exported([source], tmp_path / str(number), camera=camera).facts["cameras"] == found


def test_an_episode_without_the_depth_of_the_first_one_is_not_in_it_and_the_reason_says_so(tmp_path: Path) -> None:
    sources = [walked(tmp_path / "data", number, seconds=0.4, has_depth=number == 1) for number in (1, 2)]
    done = exported(sources, tmp_path / "out")
    (failed,) = done.failed
    assert "no camera 'head_depth' in it" in failed.reason


def test_robomimic_finds_demos_masks_and_attributes_where_its_loader_looks(tmp_path: Path) -> None:
    sources = [
        walked(
            tmp_path / "data",
            number,
            seconds=0.6,
            manifest={"quality_flags": {"success": number == 3}, "servers": {"head": {"key": HEAD, **OPTICS}}},
        )
        for number in (1, 2, 3)
    ]
    exported(sources, out := tmp_path / "out", val=0.34, seed=1)
    assert sorted(path.name for path in out.iterdir()) == ["README.md", "dataset.hdf5", "station.json"]
    splits = json.loads((out / "station.json").read_text())["splits"]
    assert (len(splits["train"]), len(splits["valid"])) == (2, 1)
    with h5py.File(out / "dataset.hdf5") as file:
        data, mask = file["data"], file["mask"]
        assert sorted(data) == ["demo_0", "demo_1", "demo_2"], "its loader takes all that is there for a demo"
        ids = {name: data[name].attrs["episode_id"] for name in data}
        for part in ("train", "valid"):
            assert [ids[name.decode()] for name in mask[part]] == splits[part]
        assert json.loads(data.attrs["env_args"]) == {"env_name": ROBOT, "type": 2, "env_kwargs": {}}
        assert data.attrs["total"] == sum(data[name].attrs["num_samples"] for name in data)
        for name in data:
            demo = data[name]
            count = demo.attrs["num_samples"]
            shapes = {key: (demo[key].shape, str(demo[key].dtype)) for key in ("actions", "dones", "rewards")}
            assert shapes == {
                "actions": ((count, 35), "float32"), "dones": ((count,), "int64"), "rewards": ((count,), "float32")
            }  # fmt: skip
            assert sorted(demo["obs"]) == ["head_image", STATE]
            assert (demo["obs/head_image"].shape, demo["obs/head_image"].dtype) == ((count, 96, 160, 3), np.uint8)
            assert {key: json.loads(demo["obs/head_image"].attrs[key]) for key in OPTICS} == OPTICS
            assert demo["dones"][:].tolist() == [0] * (count - 1) + [1]
            is_done = ids[name] == sources[2].episode_id
            assert demo["rewards"][:].tolist() == [0.0] * (count - 1) + [float(is_done)]
            described = contracts.contract(STATE)
            assert described is not None
            assert list(demo[f"obs/{STATE}"].attrs["names"]) == list(described.names)
            assert list(demo[f"obs/{STATE}"].attrs["units"]) == [element.unit for element in described.elements]
    page = (out / "README.md").read_text()
    config = json.loads(page.split("```json")[1].split("```")[0])
    assert config["observation"]["modalities"]["obs"]["low_dim"] == [STATE]
    assert config["observation"]["modalities"]["obs"]["rgb"] == ["head_image"]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_rows_are_those_of_a_lerobot_data_set(tmp_path: Path, layout: str) -> None:
    sources = [walked(tmp_path / "data", number, seconds=0.8 + 0.2 * number, jitter_s=0.002) for number in (1, 2)]
    rows = lerobot_rows(sources, tmp_path / "lerobot", fps=30)
    exported(sources, out := tmp_path / "out", fps=30, layout=layout)
    for number, source in enumerate(sources):
        of_it = rows["episode_index"] == number
        expected = {name: values[of_it] for name, values in rows.items()}
        name = "dataset.hdf5" if layout == "robomimic" else f"episode_{number}.hdf5"
        with h5py.File(out / name) as file:
            group = file[f"data/demo_{number}"] if layout == "robomimic" else file
            assert group.attrs["episode_id"] == source.episode_id
            assert group["time_ns"][:].tolist() == expected["time_ns"].tolist()
            action = group["actions" if layout == "robomimic" else "action"][:]
            assert action.tobytes() == expected["action"].astype(np.float32).tobytes()
            if layout == "robomimic":
                state, pictures = group[f"obs/{STATE}"][:], list(group["obs/head_image"])
            else:
                names = [*group["observations/qpos"].attrs["names"], *group["observations/qvel"].attrs["names"]]
                both = np.concatenate([group["observations/qpos"], group["observations/qvel"]], axis=1)
                described = contracts.contract(STATE)
                assert described is not None
                state = both[:, [names.index(name) for name in described.names]]
                pictures = [decoded(row) for row in group["observations/images/head"]]
            assert state.tobytes() == expected["observation.state"].astype(np.float32).tobytes()
            assert [number_in(picture) for picture in pictures] == shown(expected["time_ns"])


def test_act_finds_what_its_loader_looks_for(tmp_path: Path) -> None:
    source = walked(tmp_path / "data", seconds=0.6)
    exported([source], out := tmp_path / "out", layout="act")
    assert sorted(path.name for path in out.iterdir()) == ["README.md", "episode_0.hdf5", "station.json"]
    with h5py.File(out / "episode_0.hdf5") as file:
        assert bool(file.attrs["sim"]) is True, "else the loader shifts the actions by a row"
        assert bool(file.attrs["compress"]) is True
        count = len(file["action"])
        assert sorted(file["observations"]) == ["images", "qpos", "qvel"]
        assert (file["observations/qpos"].shape, file["observations/qpos"].dtype) == ((count, 33), np.float32)
        assert file["observations/qvel"].shape == (count, 32)
        assert {unit for unit in file["observations/qvel"].attrs["units"]} == {"rad/s"}
        assert "rad/s" not in file["observations/qpos"].attrs["units"]
        lengths, files = file["compress_len"][:], file["observations/images/head"]
        assert lengths.shape == (1, count)
        assert files.shape == (count, max(len(jpeg(number)) for number in range(18)))
        for row, length, number in zip(files, lengths[0], shown(file["time_ns"]), strict=True):
            assert row[:length].tobytes() == jpeg(number), "the camera's own file"
            assert not row[length:].any()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_pixels_are_those_of_the_jpeg(tmp_path: Path, layout: str) -> None:
    rng = np.random.default_rng(0)
    data = picture(np.kron(rng.integers(0, 256, (6, 10, 3)), np.ones((16, 16, 1))))
    builder = EpisodeBuilder(tmp_path / "data")
    for step in range(20):
        shoot(builder, 0, at_s=0.1 + step / 50, data=data)
        tick(builder, step, at_s=0.11 + step / 50)
    source = source_of(builder.finish({"robot": {"suffix": ROBOT}}))
    exported([source], out := tmp_path / "out", layout=layout, encoding="rgb")
    with h5py.File(next(out.glob("*.hdf5"))) as file:
        place = "data/demo_0/obs/head_image" if layout == "robomimic" else "observations/images/head"
        found = file[place][:].astype(int)
        assert layout == "robomimic" or not file.attrs["compress"]
    expected = np.array(Image.open(io.BytesIO(data))).astype(int)
    assert found.shape[1:] == expected.shape
    inside = [number for number in range(160) if 4 <= number % 16 < 12]  # at edges decoders differ in colour
    off = np.abs(found - expected)[:, inside[: 6 * 8]][:, :, inside]
    assert off.max() <= 3
    assert np.abs(found - expected[..., ::-1]).mean() > 30.0, "RGB, not BGR"


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_picture_that_cannot_be_read_is_replaced_by_the_one_before_and_counted(tmp_path: Path, layout: str) -> None:
    source = walked(tmp_path / "data", bad_pictures=(20,))
    exported([source], out := tmp_path / "out", layout=layout)
    with h5py.File(next(out.glob("*.hdf5"))) as file:
        if layout == "robomimic":
            pictures = list(file["data/demo_0/obs/head_image"])
        else:
            pictures = [decoded(row) for row in file["observations/images/head"]]
    numbers = [number_in(picture) for picture in pictures]
    assert 20 not in numbers
    assert {19, 21} < set(numbers)
    (told,) = json.loads((out / "station.json").read_text())["episodes"]
    assert told["pictures"]["head"]["bad"] == 1


def test_an_arm_has_its_torques_as_efforts_and_no_pictures_where_none_are_asked_for(tmp_path: Path) -> None:
    made = ArmRun(EpisodeBuilder(tmp_path / "data", task="jog"))
    made.move(1.0)
    exported([source_of(made.finish())], out := tmp_path / "out", layout="act", camera=("none",))
    with h5py.File(out / "episode_0.hdf5") as file:
        assert sorted(file["observations"]) == ["effort", "qpos", "qvel"]
        assert set(file["observations/effort"].attrs["units"]) == {"N m"}
        assert [name for name in file["observations/qpos"].attrs["names"] if not name.endswith("_pos")] == []


def test_a_dry_run_names_every_array_and_refuses_what_the_run_refuses(tmp_path: Path) -> None:
    sources = [walked(tmp_path / "data", 1, seconds=0.6), walked(tmp_path / "data", 2, seconds=0.6, camera_hz=0)]
    seen = preview(HDF5, sources, Hdf5Options(min_quality="any"), where=HERE)
    found = exported(sources, tmp_path / "out")
    assert seen.sources == (sources[0],)
    assert seen.left_out == found.failed
    assert "no camera 'head' in it" in found.failed[0].reason
    lines = list(HDF5.columns(seen.plan)) if HDF5.columns else []
    assert [line.partition(":")[0] for line in lines] == [
        f"obs/{STATE}", "actions", "obs/head_image", "rewards", "dones", "time_ns"
    ]  # fmt: skip
    assert lines[0].startswith(f"obs/{STATE}: 65 numbers: left_hip_pitch_pos [rad], ")


def test_what_cannot_be_is_told_in_a_line(tmp_path: Path) -> None:
    source = walked(tmp_path / "data", seconds=0.4)
    with pytest.raises(UsageError, match="--encoding jpeg: robomimic reads pixels only"):
        exported([source], tmp_path / "one", encoding="jpeg")
    with pytest.raises(EpisodeError, match=f"{keys.policy_obs(ROBOT)}' names no elements"):
        exported([source], tmp_path / "two", state=(keys.policy_obs(ROBOT),))
    builder = EpisodeBuilder(tmp_path / "data", task="two")
    for robot in ("one", "other"):
        builder.write({f"command_used_{robot}": b"[0.0]", f"policy_timing_{robot}": b"[0]"}, at_s=0.1)
    two = source_of(builder.finish())
    with pytest.raises(EpisodeError, match="several robots in it; export one at a time: --robot one or --robot other"):
        exported([two], tmp_path / "three")


@pytest.mark.parametrize("library", ["h5py", "pyarrow"])
def test_a_library_that_is_not_there_is_named_with_its_cure(tmp_path: Path, library: str) -> None:
    source = walked(tmp_path / "data", seconds=0.4, camera_hz=0)
    name, cure = ("hdf5", "teleop-station[hdf5]") if library == "h5py" else ("parquet", "pip install pyarrow")
    words = ["station", "export", name, source.folder, "--out", str(tmp_path / "out"), "--min-quality", "any"]
    code = (
        f"import sys; sys.modules[{library!r}] = None; sys.argv = {words!r}; from station.cli.main import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert library in done.stderr
    assert cure in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_full_disk_is_told_of_in_a_line(tmp_path: Path, layout: str) -> None:
    rng, builder = np.random.default_rng(0), EpisodeBuilder(tmp_path / "data")
    for step in range(100):
        shoot(builder, 0, at_s=0.1 + step / 50, data=picture(rng.integers(0, 256, (96, 160, 3))))
        tick(builder, step, at_s=0.11 + step / 50)
    source = source_of(builder.finish({"robot": {"suffix": ROBOT}}))
    (tmp_path / "disk").mkdir()
    with small_disk(tmp_path / "disk", 10) as disk:
        (disk.path / "filler").write_bytes(bytes(1 << 19))
        with pytest.raises(StationError, match=r"No space left on device; .*: make room, then run the same command"):
            exported([source], disk.path / "out", layout=layout, encoding="rgb")
        gc.collect()  # a library that could not close its file ends the process here
        assert not (disk.path / "out").exists()
