"""A RealSense through the real SDK: it plays a recording that it made of frames of ours, so no camera is needed."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.cameras.realsense import RealSenseCamera
from station import depth
from station.camera.source import Camera, CameraError, Picture, PictureSettings
from station.optics import Intrinsics, of_facts
from tests.adapters.cameras import pictures
from tests.waiting import wait_until

sdk: Any = pytest.importorskip(
    "pyrealsense2", reason="its wheels are for Linux on x86-64 and need libusb-1.0", exc_type=ImportError
)

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


STEP_M = 0.0005
"""Of the depth that the recording below has: another one than a millimetre, as some cameras have it [m]."""


def recorded_with_depth(file: Path) -> Path:
    """Have the SDK record a camera whose frame n is of grey n and 500 + 50 n mm away; depth stands aside."""
    device = sdk.software_device()
    device.register_info(sdk.camera_info.serial_number, "8472")
    device.register_info(sdk.camera_info.name, "Software RealSense")
    colour, apart = device.add_sensor("RGB Camera"), device.add_sensor("Stereo Module")
    apart.add_read_only_option(sdk.option.depth_units, STEP_M)
    profiles = []
    for sensor, kind, uid, form, size in (
        (colour, sdk.stream.color, 1, (sdk.format.rgb8, 3), SIZE),
        (apart, sdk.stream.depth, 2, (sdk.format.z16, 2), (SIZE[0] // 2, SIZE[1])),
    ):
        inner, stream = sdk.intrinsics(), sdk.video_stream()
        inner.width, inner.height = size
        inner.fx = inner.fy = 60.0
        inner.ppx, inner.ppy, inner.model, inner.coeffs = size[0] / 2, size[1] / 2, sdk.distortion.none, [0.0] * 5
        stream.type, stream.index, stream.uid, stream.fps, stream.bpp = kind, 0, uid, 60, form[1]
        stream.width, stream.height, stream.fmt, stream.intrinsics = *size, form[0], inner
        profiles.append(sensor.add_video_stream(stream))
    aside = sdk.extrinsics()
    aside.rotation, aside.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [0.015, 0.0, 0.0]
    profiles[1].register_extrinsics_to(profiles[0], aside)
    recorder, queue = sdk.recorder(str(file), device), sdk.frame_queue(4 * FRAMES)
    tapped = recorder.query_sensors()
    for one in tapped:
        one.open(one.get_stream_profiles())
        one.start(queue)
    for number in range(FRAMES):
        far = np.full((SIZE[1], SIZE[0] // 2), round((0.5 + 0.05 * number) / STEP_M), np.uint16)
        grey = np.full((SIZE[1], SIZE[0], 3), 20 * number, np.uint8)
        for sensor, profile, pixels in ((apart, profiles[1], far), (colour, profiles[0], grey)):
            frame = sdk.software_video_frame()
            frame.bpp = pixels.nbytes // (pixels.shape[0] * pixels.shape[1])
            frame.pixels, frame.stride = pixels, frame.bpp * pixels.shape[1]
            frame.timestamp, frame.frame_number, frame.domain = (
                number * 1e3 * PERIOD_S,
                number,
                sdk.timestamp_domain.system_time,
            )
            frame.profile, frame.depth_units = profile.as_video_stream_profile(), STEP_M
            sensor.on_video_frame(frame)
        time.sleep(PERIOD_S)
    for one in tapped:
        one.stop()
        one.close()
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


def test_depth_is_aligned_to_colour_and_in_millimetres_whatever_the_cameras_own_step_is(tmp_path: Path) -> None:
    file = recorded_with_depth(tmp_path / "deep.db3")
    camera = RealSenseCamera("", file, PictureSettings(quality=95, depth=True))
    facts, found = camera.facts(), list[Picture]()
    assert facts["depth"]["camera_step_m"] == pytest.approx(STEP_M)
    assert {name: facts["depth"][name] for name in ("step_m", "is_aligned")} == {"step_m": 0.001, "is_aligned": True}

    def has_looked() -> bool:
        picture = camera.read(0.1)
        found.extend([picture] if picture is not None else [])
        return len(found) >= 4

    wait_until(has_looked)
    camera.close()
    for picture in found:
        number = round(pictures.decoded(picture.jpeg).mean() / 20)
        steps = depth.decoded(picture.depth)
        assert steps is not None
        assert steps.shape == (SIZE[1], SIZE[0]), "as wide and high as colour"
        distance_mm = 500 + 50 * number
        assert set(np.unique(steps)) <= {0, distance_mm}, "of the same moment as the picture"
        seen = np.flatnonzero(steps[SIZE[1] // 2])
        shift_px = 60.0 * 0.015 / (1e-3 * distance_mm)
        assert abs(seen.mean() - (SIZE[0] / 2 + shift_px)) < 1.5, "where colour sees it, aside from where depth does"
        assert SIZE[0] // 2 - 2 <= len(seen) <= SIZE[0] // 2 + 2


def test_a_recording_without_depth_is_refused_where_depth_is_wanted(recording: Path) -> None:
    with pytest.raises(CameraError, match="expected a camera with such colour and depth streams"):
        RealSenseCamera("", recording, PictureSettings(depth=True))


def test_of_a_camera_whose_depth_nobody_wants_none_is_given(tmp_path: Path) -> None:
    camera = RealSenseCamera("", recorded_with_depth(tmp_path / "deep.db3"), SETTINGS)
    found = list[Picture]()
    wait_until(lambda: bool(found) or found.extend(filter(None, [camera.read(0.1)])) is not None)
    camera.close()
    assert [picture.depth for picture in found] == [b""]
    assert "depth" not in camera.facts()


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
