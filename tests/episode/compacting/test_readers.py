"""What reads pictures reads those of a compacted episode and is told nothing: each picture shows its number."""

from __future__ import annotations

import io
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import av
import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image
from rerun.chunk import McapReader

from adapters.exports.hdf5.kind import Hdf5Options
from adapters.exports.kinds import HDF5, LEROBOT
from adapters.exports.lerobot.kind import LeRobotOptions
from station.api import episode
from station.enrich.enrich import enrich
from station.episode.compacting.compact import compact
from station.episode.reading.reader import open_episode
from station.episode.replaying.replay import Replay, moments
from station.export.kind import Source
from station.export.run import Workers, export
from station.view.camera_strip import evenly, strips
from tests.enrich.read_back import decoded
from tests.episode.compacting.two_files import in_two_files
from tests.export.pictured import HEAD, number_in, walked

PICTURES = 30


class Pair(NamedTuple):
    """An episode as it was recorded, and the same compacted."""

    recorded: Path
    compacted: Path


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    data = tmp_path_factory.mktemp("data")
    recorded = in_two_files(Path(walked(data / "source", seconds=PICTURES / 30).folder), data / "recorded")
    compacted = data / "compacted" / "walk" / recorded.name
    shutil.copytree(recorded, compacted)
    assert compact(compacted, data / "compacted", gop=10).state == "compacted"
    return Pair(recorded, compacted)


def numbers(files: Any) -> list[int]:
    return [number_in(Image.open(io.BytesIO(bytes(file))).convert("RGB")) for file in files]


def source(folder: Path) -> Source:
    return Source(episode_id=folder.name, folder=str(folder))


def test_a_notebook_gets_every_picture_at_its_time(pair: Pair) -> None:
    recorded, compacted = (list(episode.open_episode(folder).pictures()) for folder in pair)
    assert [time_s for time_s, _ in compacted] == [time_s for time_s, _ in recorded]
    assert [number_in(rgb) for _, rgb in compacted] == list(range(PICTURES))


def test_a_replay_sends_jpeg_files(pair: Pair) -> None:
    sent = [
        list(moments(open_episode(folder), None, Replay(episode_id="", bus="", roles=[], speed=1.0))) for folder in pair
    ]
    recorded, compacted = ([group for group in groups if HEAD in group.values] for groups in sent)
    assert [group.at_ns for group in compacted] == [group.at_ns for group in recorded]
    assert numbers(group.values[HEAD] for group in compacted) == list(range(PICTURES))


def test_typed_siblings_and_reports_have_pictures(pair: Pair) -> None:
    reader = open_episode(pair.compacted)
    enrich(reader)
    found = decoded(pair.compacted / "enriched.mcap", f"{HEAD}/image")
    assert numbers(one.message.data for one in found) == list(range(PICTURES))
    assert all(one is not None and one.jpeg for one in strips(reader, evenly(reader, 7), 220)["head"])


def test_rows_of_a_lerobot_data_set_are_the_same_and_their_pictures_as_good(pair: Pair, tmp_path: Path) -> None:
    rows, shown = [], []
    for folder in pair:
        out = tmp_path / folder.parent.parent.name
        export(LEROBOT, [source(folder)], LeRobotOptions(min_quality="any"), out, where=Workers(jobs=1))
        rows.append(pq.read_table(out / "data/chunk-000/file-000.parquet").to_pydict())
        (video,) = out.glob("videos/**/*.mp4")
        with av.open(str(video)) as file:
            shown.append([frame.to_ndarray(format="rgb24").astype(float) for frame in file.decode(video=0)])
    assert rows[0] == rows[1]
    assert [number_in(rgb) for rgb in shown[0]] == [number_in(rgb) for rgb in shown[1]]
    for one, other in zip(*shown, strict=True):
        assert 10 * np.log10(255**2 / max(1e-9, ((one - other) ** 2).mean())) > 35.0


def test_jpeg_files_of_an_hdf5_data_set_show_the_rows_of_the_recording(pair: Pair, tmp_path: Path) -> None:
    found = []
    for folder in pair:
        out = tmp_path / folder.parent.parent.name
        wish = Hdf5Options(min_quality="any", layout="act")
        export(HDF5, [source(folder)], wish, out, where=Workers(jobs=1))
        with h5py.File(next(out.glob("*.hdf5"))) as file:
            found.append(numbers(row.tobytes() for row in file["observations/images/head"]))
    assert found[0] == found[1]
    assert len(found[0]) > 20


def test_rerun_takes_the_file_for_a_video_stream(pair: Pair) -> None:
    chunks = [chunk for chunk in McapReader(pair.compacted / "cameras.mcap").stream()
              if str(chunk.entity_path) == f"/{HEAD}"]  # fmt: skip
    columns = {name for chunk in chunks for name in chunk.to_record_batch().schema.names}
    assert "VideoStream:sample" in columns
    assert sum(chunk.num_rows for chunk in chunks if "VideoStream:sample" in chunk.to_record_batch().schema.names) == 30
