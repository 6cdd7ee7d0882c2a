"""A video whose container is broken, not only a picture in it: told in one line, with the file's name."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from adapters.cameras.files import FilesCamera
from station.camera.source import CameraError, PictureSettings

pytest.importorskip("av")


def raw_video(file: Path, *heads: bytes) -> Path:
    """An uncompressed video with such a head before each picture, which is ``FRAME`` in one that is whole."""
    blocks = [head + b"\n" + bytes(160 * 120 * 3 // 2) for head in heads]
    file.write_bytes(b"YUV4MPEG2 W160 H120 F20:1 Ip A1:1 C420\n" + b"".join(blocks))
    return file


def play(camera: FilesCamera) -> None:
    while camera.read(5.0) is not None:
        pass


@pytest.mark.parametrize("is_looped", [True, False])
def test_a_video_that_breaks_off_in_the_middle_is_told_when_it_comes_to_that(tmp_path: Path, is_looped: bool) -> None:
    file = raw_video(tmp_path / "clip.y4m", b"FRAME", b"FRAME", b"FRA", b"FRAME")
    camera = FilesCamera(file, PictureSettings(), is_looped=is_looped)
    why = "cannot be read to its end: Invalid data found when processing input; is the file whole?"
    with pytest.raises(CameraError, match=f"^{re.escape(f'{file}: {why}')}$"):
        play(camera)
    camera.close()


def test_a_video_that_breaks_off_before_its_first_picture_is_refused(tmp_path: Path) -> None:
    file = raw_video(tmp_path / "clip.y4m", b"FRA", b"FRAME")
    with pytest.raises(CameraError, match=re.escape(f"{file}: cannot be read to its end: Invalid data found")):
        FilesCamera(file, PictureSettings())


def test_a_whole_one_of_the_kind_is_played_to_its_end(tmp_path: Path) -> None:
    camera = FilesCamera(raw_video(tmp_path / "clip.y4m", b"FRAME", b"FRAME"), PictureSettings(), is_looped=False)
    play(camera)
    assert "played to its end" in camera.why_silent()
