"""Depth in a LeRobot data set: left out and said so unless it is asked for; then as LeRobot's own reader wants it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow.parquet as pq
import pytest

from adapters.exports.kinds import LEROBOT
from adapters.exports.lerobot.depth_codes import codes_of, millimetres
from adapters.exports.lerobot.kind import LeRobotOptions
from station.errors import UsageError
from station.export.kind import Source
from station.export.run import Workers, export, preview
from tests.adapters.exports.lerobot.test_append import appended, exported
from tests.adapters.exports.test_hdf5 import shown
from tests.export.pictured import DEPTH, walked

pytestmark = pytest.mark.usefixtures("processes")

COLUMN = "observation.images.head_depth"


def read(out: Path) -> Any:
    """All depth of a data set in millimetres, as LeRobot 0.6 says that its codes are to be read, shape (n, h, w)."""
    about = json.loads((out / "meta/info.json").read_text())["features"][COLUMN]["info"]
    first, last = (math.log(about[f"video.depth_{end}"] + about["video.shift"]) for end in ("min", "max"))
    frames = [
        frame.to_ndarray(format="gray12le")
        for file in sorted((out / "videos" / COLUMN).rglob("*.mp4"))
        for frame in av.open(str(file)).decode(video=0)
    ]
    return 1e3 * (np.exp(first + np.array(frames) / 4095 * (last - first)) - about["video.shift"])


def test_every_distance_comes_back_within_half_a_step_of_its_code() -> None:
    steps = np.arange(65536, dtype=np.uint16)
    found, metres = millimetres()[codes_of(steps, 0.001)], steps * 1e-3
    between = (metres >= 0.01) & (metres <= 10.0)
    bound_mm = 0.5e3 * (metres + 3.5) * math.log(13.5 / 3.51) / 4095 + 0.5  # half of a step, and of a millimetre
    assert (np.abs(found - steps) <= bound_mm)[between].all()
    assert found[0] == 10.0, "what was not measured reads as the nearest"
    assert found[12_000] == 10_000.0, "what is farther reads as the farthest"
    assert (codes_of(steps[:1000], 0.002) == codes_of(2 * steps[:1000], 0.001)).all()


def test_depth_is_left_out_and_both_runs_say_so(tmp_path: Path) -> None:
    source = walked(tmp_path / "data", seconds=0.4, has_depth=True)
    seen = preview(LEROBOT, [source], LeRobotOptions(min_quality="any"), where=Workers(jobs=1))
    assert f"{source.episode_id}: depth, not in the data set: head" in seen.notes
    done = exported([source], out := tmp_path / "out")
    (told,) = [note for note in done.facts["notes"] if "depth" in note]
    assert "1 of 1 episodes" in told
    assert "have depth of head, which is not in the data set; with --depth it is" in told
    assert COLUMN not in json.loads((out / "meta/info.json").read_text())["features"]


def test_depth_that_is_asked_for_is_video_of_twelve_bits_and_each_row_has_its_own(tmp_path: Path) -> None:
    sources = [walked(tmp_path / "data", number, seconds=0.5, has_depth=True) for number in (1, 2)]
    done = exported(sources, out := tmp_path / "out", fps=30, depth=True)
    assert not [note for note in done.facts["notes"] if "depth" in note]
    feature = json.loads((out / "meta/info.json").read_text())["features"][COLUMN]
    assert (feature["dtype"], feature["shape"]) == ("video", [47, 81, 1])
    about = feature["info"]
    assert {name: about[name] for name in ("is_depth_map", "depth_unit", "video.codec", "video.pix_fmt")} == {
        "is_depth_map": True, "depth_unit": "mm", "video.codec": "hevc", "video.pix_fmt": "gray12le",
    }  # fmt: skip
    rows = pq.read_table(out / "data/chunk-000/file-000.parquet").to_pydict()
    found = read(out)
    assert found.shape == (len(rows["time_ns"]), 47, 81)
    assert np.abs(found[:, 9, 9] - 1000 - shown(rows["time_ns"])).max() < 1.3
    assert found[:, 0].max() == pytest.approx(10.0)
    assert "age_s.camera.head_depth" in rows
    stats = json.loads((out / "meta/stats.json").read_text())[COLUMN]
    assert np.shape(stats["mean"]) == (1, 1, 1)
    assert stats["min"] == [[[10.0]]]
    assert 1000 < stats["q50"][0][0][0] < 1030
    page = (out / "README.md").read_text()
    assert f"| `{COLUMN}` | 81 x 47 pixels | `{DEPTH}` |" in page
    assert "video of 12 bits without loss" in page


def test_an_episode_with_depth_is_added_as_if_all_had_been_exported_together(tmp_path: Path) -> None:
    sources: list[Source] = [walked(tmp_path / "data", number, seconds=0.5, has_depth=True) for number in (1, 2)]
    exported(sources, together := tmp_path / "together", depth=True)
    exported(sources[:1], one_by_one := tmp_path / "one", depth=True)
    with pytest.raises(UsageError, match="made with --depth True, and --depth False is asked for"):
        appended(sources[1:], one_by_one, depth=False)
    appended(sources[1:], one_by_one, depth=True)
    assert (read(one_by_one) == read(together)).all()
    before, after = (json.loads((out / "meta/stats.json").read_text())[COLUMN] for out in (together, one_by_one))
    assert before == after


def test_a_layout_that_knows_no_depth_is_refused_with_it(tmp_path: Path) -> None:
    source = walked(tmp_path / "data", seconds=0.2, has_depth=True)
    options = LeRobotOptions(min_quality="any", depth=True, layout="v2.1")
    with pytest.raises(UsageError, match=r"--depth: LeRobot knows depth in layout v3.0 alone, not in v2.1"):
        export(LEROBOT, [source], options, tmp_path / "out", where=Workers(jobs=1))
