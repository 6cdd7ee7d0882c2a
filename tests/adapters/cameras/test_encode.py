"""From a camera's raw pixels to a file, without a change of brightness or of place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.cameras.encode import Encoder, library
from station.camera.source import CameraError
from tests.adapters.cameras import pictures


@pytest.mark.parametrize("is_full_range", [True, False])
def test_raw_pixels_of_either_range_become_the_same_picture(*, is_full_range: bool) -> None:
    raw = pictures.yuyv(4711, is_full_range=is_full_range)
    file = Encoder(95).yuyv(raw, 160, 120, 320, is_full_range=is_full_range)
    difference = pictures.decoded(file).astype(int) - pictures.pixels(4711)
    assert np.abs(difference).mean() < 2.0
    assert pictures.number(file) == 4711


def test_rows_may_be_padded() -> None:
    rows = np.frombuffer(pictures.yuyv(99, is_full_range=True), np.uint8).reshape(120, 320)
    padded = np.pad(rows, ((0, 0), (0, 64))).tobytes()
    assert pictures.number(Encoder(90).yuyv(padded, 160, 120, 384, is_full_range=True)) == 99


def test_colours_are_those_of_the_camera() -> None:
    red_bt601 = np.tile(np.array([81, 90, 81, 240], np.uint8), (120, 80))  # Y U Y V of pure red, limited range
    shown = pictures.decoded(Encoder(95).yuyv(red_bt601.tobytes(), 160, 120, 320, is_full_range=False))
    np.testing.assert_allclose(shown.mean(axis=(0, 1)), (255, 0, 0), atol=4)


def test_a_higher_quality_makes_a_larger_file() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (120, 160, 3), dtype=np.uint8)
    assert len(Encoder(95).rgb(noise)) > 1.5 * len(Encoder(50).rgb(noise))


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (None, r"which is not installed; pip install 'teleop-station\[realsense\]'"),
        ("raise ImportError('libx.so.0: cannot open shared object file')",
         r"which is installed and cannot be loaded \(libx.so.0: cannot open .*\); install that library with the"),
    ],
)  # fmt: skip
def test_a_library_that_is_missing_and_one_that_misses_something_are_told_apart(
    found: str | None, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if found is not None:
        (tmp_path / "camera_sdk.py").write_text(found)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(CameraError, match=f"^the source realsense needs camera-sdk, {said}"):
        library("camera_sdk", "camera-sdk", "the source realsense", extra="realsense")
