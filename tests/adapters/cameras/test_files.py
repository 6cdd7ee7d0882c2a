"""Files as a camera: which pictures, when, and what is left out."""

from __future__ import annotations

import re
import time
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from adapters.cameras.files import FilesCamera
from station.camera.source import Camera, CameraError, Picture, PictureSettings
from tests.adapters.cameras import pictures

FAST = PictureSettings(fps=100.0)


def folder_of(folder: Path, *numbers: int) -> Path:
    for number in numbers:
        (folder / f"frame{number}.jpg").write_bytes(pictures.jpeg(number))
    return folder


def video_of(file: Path, count: int, fps: int = 20) -> Path:
    with av.open(str(file), "w") as container:
        stream = container.add_stream("libx264", rate=fps, options={"crf": "10"})
        stream.width, stream.height = 160, 120
        for number in range(count):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pictures.pixels(number), format="rgb24")))
        container.mux(stream.encode())
    return file


def next_of(camera: FilesCamera) -> Picture:
    picture = camera.read(5.0)
    assert picture is not None
    return picture


def test_pictures_of_a_folder_come_in_the_order_of_their_numbers_byte_for_byte_and_again(tmp_path: Path) -> None:
    camera = FilesCamera(folder_of(tmp_path, 2, 10, 1), FAST)
    shown = [next_of(camera) for _ in range(5)]
    places = [(picture.capture_ns - shown[0].capture_ns) // 10_000_000 for picture in shown]
    assert [picture.jpeg for picture in shown] == [pictures.jpeg((1, 2, 10)[place % 3]) for place in places]
    assert camera.drops.skipped == places[-1] - 4, "which one is due, the time says: what is late is skipped"
    assert isinstance(camera, Camera)
    facts = camera.facts()
    assert (facts["width"], facts["height"], facts["fps"], facts["is_passed_through"]) == (160, 120, 100.0, True)


def test_each_is_taken_a_period_after_the_one_before_whenever_it_is_read(tmp_path: Path) -> None:
    camera = FilesCamera(folder_of(tmp_path, 1, 2, 3), PictureSettings(fps=50.0))
    first = next_of(camera)
    time.sleep(0.07)
    second = next_of(camera)
    periods, rest = divmod(second.capture_ns - first.capture_ns, 20_000_000)
    assert rest == 0
    assert periods >= 3
    assert camera.drops.skipped == periods - 1
    assert second.capture_ns <= time.monotonic_ns()


def test_no_picture_is_given_before_it_is_due(tmp_path: Path) -> None:
    camera = FilesCamera(folder_of(tmp_path, 1, 2), PictureSettings(fps=0.2))
    assert next_of(camera).jpeg == pictures.jpeg(1)
    assert camera.read(0.01) is None
    assert camera.drops.total == 0


def test_what_is_not_repeated_ends_and_says_so(tmp_path: Path) -> None:
    camera = FilesCamera(folder_of(tmp_path, 1), FAST, is_looped=False)
    next_of(camera)
    assert camera.why_silent() == ""
    assert camera.read(0.05) is None
    assert "played to its end" in camera.why_silent()


def test_a_broken_picture_is_left_out_and_counted(tmp_path: Path) -> None:
    folder_of(tmp_path, 1, 2)
    (tmp_path / "frame2.jpg").write_bytes(pictures.jpeg(2)[:-40])
    camera = FilesCamera(tmp_path, FAST)
    shown = [camera.read(5.0) for _ in range(4)]
    assert camera.drops.torn >= 1
    assert {pictures.number(picture.jpeg) for picture in shown if picture is not None} == {1}


def test_pictures_of_another_kind_or_size_are_encoded_anew(tmp_path: Path) -> None:
    Image.fromarray(pictures.pixels(77)).save(tmp_path / "a.png")
    camera = FilesCamera(tmp_path, PictureSettings(fps=100.0, width=320, height=240, quality=80))
    shown = next_of(camera).jpeg
    assert pictures.decoded(shown).shape == (240, 320, 3)
    assert pictures.number(shown) == 77
    assert camera.facts()["is_passed_through"] is False
    assert camera.facts()["quality"] == 80


def test_a_video_is_played_at_its_own_rate_frame_by_frame(tmp_path: Path) -> None:
    camera = FilesCamera(video_of(tmp_path / "clip.mp4", 12), PictureSettings())
    shown = [next_of(camera) for _ in range(14)]
    start_ns = shown[0].capture_ns
    assert camera.facts()["fps"] == 20.0
    for picture in shown:  # which frame it must be, its time says, however busy this machine is
        assert pictures.number(picture.jpeg) == (picture.capture_ns - start_ns) // 50_000_000 % 12
    camera.close()


def test_a_video_may_be_shown_in_another_size(tmp_path: Path) -> None:
    camera = FilesCamera(video_of(tmp_path / "clip.mp4", 3), PictureSettings(width=80, height=60))
    assert pictures.decoded(next_of(camera).jpeg).shape == (60, 80, 3)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("missing", None, "no such file or folder; expected a folder of pictures, or a video file"),
        ("notes.txt", b"no video", "cannot be read: Invalid data found when processing input; expected pictures or a"),
        ("a.jpg", pictures.jpeg(1)[:300], ""),
    ],
)
def test_what_cannot_be_played_is_refused_by_name(
    tmp_path: Path, name: str, content: bytes | None, message: str
) -> None:  # fmt: skip
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(CameraError, match=re.escape(f"{path}: {message}")):
        FilesCamera(path, PictureSettings())


def test_a_folder_without_pictures_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CameraError, match=r"no pictures in it; expected files that end in \.jpg, \.jpeg, \.png"):
        FilesCamera(tmp_path, PictureSettings())


def test_numbers_can_be_read_back_from_pixels() -> None:
    assert [pictures.number(pictures.jpeg(n)) for n in (0, 1, 21845, 65535)] == [0, 1, 21845, 65535]
    assert np.array_equal(pictures.pixels(5), pictures.pixels(5))
