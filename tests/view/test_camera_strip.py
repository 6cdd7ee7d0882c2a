"""Small pictures of depth, as contact sheets and reports show them: near and far apart, no depth black."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from station import depth
from station.episode.reading.reader import open_episode
from station.view.camera_strip import Thumbnail, evenly, strips
from tests.episode.depth_scenes import filmed


def shown(thumbnail: Thumbnail | None) -> NDArray[np.int64]:
    assert thumbnail is not None
    assert thumbnail.jpeg is not None
    return np.asarray(Image.open(io.BytesIO(thumbnail.jpeg)), dtype=np.int64)


def test_depth_goes_from_yellow_to_blue_and_is_black_where_there_is_none(tmp_path: Path) -> None:
    reader = open_episode(filmed(tmp_path))
    found = strips(reader, evenly(reader, 3), 60)
    assert list(found) == ["head_depth"]
    for thumbnail in found["head_depth"]:
        picture = shown(thumbnail)
        assert picture.shape == (45, 60, 3)
        assert picture[:, 0].max() < 60, "the stripe without depth"
        box, floor = picture[22, 30], picture[44, 40]
        assert (box[0] > 200, box[2] < 80) == (True, True), "near is yellow"
        assert box[1] > 200
        assert floor[0] < 100, "far is blue"
        assert floor[2] > 60


def test_a_picture_in_which_nothing_was_measured_is_black_and_a_broken_one_is_none(tmp_path: Path) -> None:
    nothing = depth.encoded(np.zeros((60, 80), np.uint16))
    reader = open_episode(filmed(tmp_path, lambda shot: nothing if shot.at_s < 3.0 else b"no picture"))
    first, last = strips(reader, [1.0, 5.0], 60)["head_depth"]
    assert shown(first).max() < 30
    assert last is not None
    assert last.jpeg is None
