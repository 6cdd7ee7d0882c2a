"""Depth in an episode that the real writer made: beside colour in its file, named in the manifest, read back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from station import depth
from station.bus import keys
from station.bus.tap import Write
from station.episode.reading.frames import all_pictures, cameras, depths, frames, optics, step_m
from station.episode.reading.reader import open_episode
from station.protobuf import schema
from tests.episode.depth_scenes import steps
from tests.episode.filming import HEAD, Scene, film, jpeg
from tests.export.pictured import OPTICS

DEPTH = keys.camera_depth("head")
PICTURES = 12
FACTS: dict[str, Any] = {
    "camera": "head", "key": HEAD, "width": 80, "height": 60, "fps": 30.0, **OPTICS,
    "depth": {"key": DEPTH, "step_m": 0.001, "range_m": [0.2, 8.0], "is_aligned": True},
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made, scene = tmp_path_factory.mktemp("data") / "walk" / "2026-11-21-g1-walk-0001", Scene()
    batches: list[list[Write]] = []
    for number in range(PICTURES):
        picture = scene.picture(data=jpeg(number))
        beside = picture._replace(key=DEPTH, value=depth.encoded(steps(number)))
        batches.append([*scene.signals(2), picture, beside])
    film(made, batches, scene.anchor, servers={"head": FACTS})
    return made


def test_depth_stands_beside_colour_as_foxglove_shows_it(folder: Path) -> None:
    with (folder / "cameras.mcap").open("rb") as file:
        found = [
            (schema_.name, channel.topic, schema.message_class(schema.Schema(schema_.name, schema_.data)), message.data)
            for schema_, channel, message in make_reader(file).iter_messages([DEPTH])
            if schema_ is not None
        ]
    assert len(found) == PICTURES
    for number, (name, topic, kind, data) in enumerate(found):
        image = kind.FromString(data)
        assert (name, topic, image.format, image.frame_id) == ("foxglove.CompressedImage", DEPTH, "png", "head")
        assert image.data == depth.encoded(steps(number))


def test_a_picture_and_its_depth_are_of_one_moment(folder: Path) -> None:
    reader = open_episode(folder)
    colour, beside = (list(frames(reader, key)) for key in (HEAD, DEPTH))
    assert [frame.captured_ns for frame in beside] == [frame.captured_ns for frame in colour]
    for number, frame in enumerate(beside):
        assert np.array_equal(depth.decoded(frame.data), steps(number))


def test_depth_is_no_camera_of_its_own(folder: Path) -> None:
    reader = open_episode(folder)
    assert cameras(reader) == {"head": HEAD}
    assert depths(reader) == {"head": DEPTH}
    assert all_pictures(reader) == {"head": HEAD, "head_depth": DEPTH}
    assert step_m(reader, DEPTH) == 0.001


def test_the_manifest_names_depth_with_its_step_and_optics(folder: Path) -> None:
    manifest = open_episode(folder).manifest
    (beside, colour) = manifest.cameras
    assert colour == {"name": "head", "key": HEAD, "pictures": PICTURES, "width": 80, "height": 60, "fps": 30.0}
    assert beside == {
        "name": "head", "key": DEPTH, "pictures": PICTURES, "width": 80, "height": 60, "fps": 30.0,
        "step_m": 0.001, "range_m": [0.2, 8.0], "is_aligned": True, "intrinsics": OPTICS["intrinsics"],
    }  # fmt: skip


def test_optics_of_a_camera_are_those_of_its_depth_unless_it_states_others(folder: Path) -> None:
    found, why_not = optics(open_episode(folder))
    assert why_not == {}
    assert found[DEPTH] == found[HEAD]
