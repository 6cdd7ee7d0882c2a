"""A RealSense through the real SDK: it plays a recording that it made of frames of ours, so no camera is needed."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.cameras.realsense import RealSenseCamera
from station.camera.source import Camera, CameraError, Picture, PictureSettings
from station.optics import Intrinsics, of_facts
from tests.adapters.cameras import pictures
from tests.waiting import wait_until

sdk: Any = pytest.importorskip("pyrealsense2", reason="its wheels are for Linux on x86-64")

SIZE, FRAMES, PERIOD_S = (64, 48), 12, 1 / 60
SETTINGS = PictureSettings(quality=95)


def recorded(file: Path, model: Any, coefficients: list[float]) -> Path:
    """Have the SDK record a colour camera whose frame n is of grey n."""
    device = sdk.software_device()
    device.register_info(sdk.camera_info.serial_number, "8471")
    device.register_info(sdk.camera_info.name, "Software RealSense")
    inner = sdk.intrinsics()
    inner.width, inner.height = SIZE
    inner.fx, inner.fy, inner.ppx, inner.ppy, inner.model, inner.coeffs = 60.0, 61.0, 31.0, 24.0, model, coefficients
    stream = sdk.video_stream()
    stream.type, stream.index, stream.uid, stream.fps, stream.bpp = sdk.stream.color, 0, 1, 60, 3
    stream.width, stream.height, stream.fmt, stream.intrinsics = *SIZE, sdk.format.rgb8, inner
    sensor = device.add_sensor("RGB Camera")
    profile = sensor.add_video_stream(stream)
    recorder = sdk.recorder(str(file), device)
    (tapped,) = recorder.query_sensors()
    queue = sdk.frame_queue(FRAMES)
    tapped.open(tapped.get_stream_profiles())
    tapped.start(queue)
    for number in range(FRAMES):
        frame = sdk.software_video_frame()
        frame.pixels = np.full((SIZE[1], SIZE[0], 3), 20 * number, dtype=np.uint8)
        frame.stride, frame.bpp, frame.timestamp, frame.frame_number = 3 * SIZE[0], 3, number * 1e3 * PERIOD_S, number
        frame.domain, frame.profile = sdk.timestamp_domain.system_time, profile.as_video_stream_profile()
        sensor.on_video_frame(frame)
        time.sleep(PERIOD_S)
    tapped.stop()
    tapped.close()
    return file


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(
        tmp_path_factory.mktemp("sdk") / "grey.db3", sdk.distortion.brown_conrady, [0.1, 0.2, 0.0, 0.0, 0.3]
    )


def test_pictures_of_the_sdk_come_with_the_factorys_intrinsics(recording: Path) -> None:
    camera = RealSenseCamera("", recording, SETTINGS)
    assert isinstance(camera, Camera)
    facts, found = camera.facts(), list[Picture]()
    assert (facts["width"], facts["height"], facts["fps"], facts["serial"]) == (*SIZE, 60.0, "8471")
    assert facts["device"] == "Software RealSense"
    assert of_facts(facts).intrinsics == Intrinsics(
        width=64, height=48, fx=60.0, fy=61.0, cx=31.0, cy=24.0, distortion="plumb_bob",
        coefficients=tuple(float(np.float32(one)) for one in (0.1, 0.2, 0.0, 0.0, 0.3)), source="factory, by the SDK",
    )  # fmt: skip

    def has_looked() -> bool:
        before_ns = time.monotonic_ns()
        picture = camera.read(0.1)
        if picture is not None:
            assert before_ns <= picture.capture_ns <= time.monotonic_ns(), (
                "the recording's own times are of another day"
            )
            found.append(picture)
        return len(found) >= 3

    wait_until(has_looked)
    camera.close()
    greys = [pictures.decoded(picture.jpeg) for picture in found]
    assert {grey.shape for grey in greys} == {(48, 64, 3)}
    assert {round(grey.mean() / 20) for grey in greys} <= set(range(FRAMES))
    assert all(abs(grey.mean() / 20 - round(grey.mean() / 20)) < 0.1 for grey in greys)


def test_a_model_that_is_none_of_opencvs_gives_no_intrinsics_and_a_reason(tmp_path: Path) -> None:
    inverse = sdk.distortion.inverse_brown_conrady
    camera = RealSenseCamera("", recorded(tmp_path / "bent.db3", inverse, [0.1, 0.0, 0.0, 0.0, 0.0]), SETTINGS)
    assert "intrinsics" not in camera.facts()
    assert "of the model inverse_brown_conrady" in camera.facts()["intrinsics_why_not"]
    straight = RealSenseCamera("", recorded(tmp_path / "straight.db3", inverse, [0.0] * 5), SETTINGS)
    assert straight.facts()["intrinsics"]["distortion"] == "none"


def test_what_cannot_be_is_told_in_a_line(tmp_path: Path, recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "text.db3").write_text("no recording")
    wide = PictureSettings(width=1280, height=720)
    for serial, file, settings, told in (
        ("", tmp_path / "none.db3", SETTINGS, r"none.db3: no such file; expected a recording of the RealSense SDK"),
        ("", tmp_path / "text.db3", SETTINGS, r"text.db3: .*; expected a (recording|camera)"),
        ("", recording, wide, "a recording has its own size and rate; leave out width, height and fps"),
        ("1234", None, SETTINGS, "no RealSense with serial number 1234: none is plugged in; set options.serial"),
    ):
        with pytest.raises(CameraError, match=told) as caught:
            RealSenseCamera(serial, file, settings)
        assert "\n" not in str(caught.value)
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(CameraError, match=r"pip install 'teleop-station\[realsense\]'"):
        RealSenseCamera("", None, SETTINGS)
