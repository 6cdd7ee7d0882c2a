"""The camera server as a process of its own: our calls over a fake driver, files, and a real bus."""

from __future__ import annotations

import errno
import re
import signal
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from servers.camera import CameraConfig
from station.bus import keys
from station.bus.address import BusAddress
from station.config import build
from station.errors import ConfigError
from tests.adapters.cameras import pictures
from tests.adapters.cameras.fake_v4l2 import fake
from tests.adapters.cameras.fake_v4l2.fake import FakeCamera, Mode
from tests.servers.camera_station import CameraStation, camera_station
from tests.waiting import wait_until

SMALL = {"width": 160, "height": 120}


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fake.build(tmp_path_factory.mktemp("v4l2"))


@pytest.fixture
def devices() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="dev") as name:  # short: a socket's path has 108 characters at most
        yield Path(name)


@pytest.fixture
def station(bus_server: BusAddress, tmp_path: Path) -> Iterator[CameraStation]:
    with camera_station("head", bus_server, tmp_path) as made:
        yield made


def begin(station: CameraStation, camera: FakeCamera, **settings: object) -> None:
    """Start the server on a camera, and wait until it takes pictures."""
    options = {"devices": str(camera.path.parent)}
    station.start("uvc", environment=camera.environment, **{"options": options, **SMALL, **settings})
    station.until_active()


def pass_on(station: CameraStation, camera: FakeCamera, *numbers: int) -> list[int]:
    """Take pictures one by one, each when the one before has arrived; return when they were taken [ns]."""
    taken = []
    for number in numbers:
        before = len(station.shots)
        taken.append(camera.take(pictures.jpeg(number)))
        station.until(lambda before=before: len(station.shots) > before)  # type: ignore[misc]
    return taken


def test_a_cameras_jpeg_files_come_through_unchanged_with_the_drivers_times(
    station: CameraStation, library: Path, devices: Path
) -> None:
    with fake.camera(library, devices, [Mode("YUYV"), Mode("MJPG")], is_exposure_known=True) as camera:
        begin(station, camera)
        taken = pass_on(station, camera, *range(100, 110))
        assert [shot.jpeg for shot in station.shots] == [pictures.jpeg(number) for number in range(100, 110)]
        assert [shot.stamp.capture_ns for shot in station.shots] == taken
        assert [shot.stamp.seq for shot in station.shots] == list(range(1, 11))
        facts = station.facts
        assert (facts["format"], facts["width"], facts["height"], facts["fps"]) == ("MJPG", 160, 120, 30.0)
        assert (facts["device"], facts["card"]) == (str(camera.path), "Fake Cam")
        assert facts["exposure"] == {"is_auto": False, "time_s": 0.01}
        assert facts["key"] == keys.camera_image("head")
        station.until(lambda: station.detail.get("pictures") == 10)
        assert station.detail["dropped"] == 0
        assert station.stop() == 0


def test_what_the_camera_lost_or_spoiled_is_counted_by_reason_and_told(
    station: CameraStation, library: Path, devices: Path
) -> None:
    with fake.camera(library, devices) as camera:
        begin(station, camera)
        pass_on(station, camera, 1)
        camera.sequence += 3
        pass_on(station, camera, 2)
        camera.take(pictures.jpeg(3)[:-40])
        camera.take(pictures.jpeg(4), is_damaged=True)
        station.until(lambda: station.detail.get("torn") == 2)
        pass_on(station, camera, 5)
        assert [pictures.number(shot.jpeg) for shot in station.shots] == [1, 2, 5]
        assert (station.detail["lost"], station.detail["dropped"]) == (3, 5)
        station.until(lambda: station.told("camera-dropping"))  # when it ends is told later: tests/camera/test_serve.py


def test_of_pictures_that_waited_the_newest_goes_to_the_bus(
    station: CameraStation, library: Path, devices: Path
) -> None:
    with fake.camera(library, devices) as camera:
        begin(station, camera)
        pass_on(station, camera, 1)
        station.process.send_signal(signal.SIGSTOP)
        wait_until(lambda: is_stopped(station.process.pid))
        for number in (2, 3, 4):
            camera.take(pictures.jpeg(number))
        station.process.send_signal(signal.SIGCONT)
        station.until(lambda: pictures.number(station.shots[-1].jpeg) == 4)
        assert [pictures.number(shot.jpeg) for shot in station.shots] == [1, 4]
        station.until(lambda: station.detail.get("skipped") == 2)


def is_lost(station: CameraStation, reason: str) -> bool:
    """Whether it was told that the camera is lost for a reason; a busy machine may add another one."""
    return any(reason in event.detail["reason"] for event in station.told("camera-lost"))


def is_stopped(pid: int) -> bool:
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "T"


def test_a_camera_that_is_torn_out_is_lost_and_comes_back_by_itself(
    station: CameraStation, library: Path, devices: Path
) -> None:
    with fake.camera(library, devices) as camera:
        begin(station, camera)
        pass_on(station, camera, 1)
        backs = len(station.told("camera-back"))
        camera.unplug()
        station.until(lambda: is_lost(station, "gone; plug it in again"))
        station.until(lambda: is_lost(station, "no camera found"))
        station.until(lambda: station.detail.get("camera") == "lost")
        camera.plug_in()
        taken = pass_on(station, camera, 2)
        station.until(lambda: len(station.told("camera-back")) > backs)
        assert station.shots[-1].jpeg == pictures.jpeg(2)
        assert station.shots[-1].stamp.capture_ns == taken[0]
        assert len(station.told("camera-back")) == backs + 1
        station.until(lambda: station.detail.get("camera") == "live")
        assert station.detail["lost"] == 0, "a stream that begins anew has no hole"
        assert station.stop() == 0


@pytest.mark.parametrize(
    ("fails", "told"),
    [
        (False, "gives no pictures; is it covered by a switch"),
        (True, "the line to it fails; try another cable"),
    ],
    ids=["gives nothing", "its line fails"],
)
def test_a_camera_without_pictures_is_lost_until_it_has_some(
    station: CameraStation, library: Path, devices: Path, fails: bool, told: str
) -> None:
    with fake.camera(library, devices) as camera:
        begin(station, camera)
        if fails:
            pass_on(station, camera, 1)
            camera.fail(errno.EIO)
        station.until(lambda: is_lost(station, told))
        pass_on(station, camera, 2)
        station.until(lambda: station.told("camera-back"))


def test_of_a_range_of_sizes_and_rates_a_camera_is_set_to_what_is_wanted(
    station: CameraStation, library: Path, devices: Path
) -> None:
    with fake.camera(library, devices, [Mode("MJPG", 1920, 1080, 60)], is_range=True) as camera:
        begin(station, camera, fps=25)
        pass_on(station, camera, 1)
        assert [station.facts[name] for name in ("width", "height", "fps")] == [160, 120, 25.0]


def test_raw_pictures_are_encoded_here_and_a_time_that_is_none_is_that_of_arrival(
    station: CameraStation, library: Path, devices: Path
) -> None:
    with fake.camera(library, devices, [Mode("YUYV")]) as camera:
        begin(station, camera, quality=80)
        before_ns = time.monotonic_ns()
        camera.take(pictures.yuyv(1234), is_stamped=False, age_s=0.5)
        station.until(lambda: station.shots)
        (shot,) = station.shots
        assert pictures.number(shot.jpeg) == 1234
        assert before_ns <= (shot.stamp.capture_ns or 0) <= shot.stamp.mono_ns
        assert (station.facts["format"], station.facts["is_passed_through"], station.facts["quality"]) == (
            "YUYV", False, 80,
        )  # fmt: skip


@pytest.mark.parametrize(
    ("driver", "settings", "message"),
    [
        ({}, {"options": {"device": "/nowhere/video7"}},
         r"/nowhere/video7: no such device; there are .*/video0 Fake Cam"),
        ({}, {"options": {"serial": "B2"}}, r"no camera with serial 'B2' found; there are .*/video0 Fake Cam"),
        ({"open_errno": 13}, {}, r"permission denied; add yourself to the group .* sudo usermod -aG \w+ \$USER"),
        ({"buffers_errno": 16}, {}, r"busy: another program reads it; `fuser -v .*/video0` names it"),
        ({"format_errno": 16}, {}, r"busy: another program reads it"),
        ({}, {"width": 640, "height": 480},
         r"offers no MJPG or YUYV 640x480@30; it offers MJPG 160x120@30; set width, height and fps to one of these"),
        ({}, {"fps": 60}, r"offers no MJPG or YUYV 160x120@60; it offers MJPG 160x120@30"),
    ],
    ids=["no such device", "no such serial", "no permission", "busy", "busy at once", "size", "rate"],
)  # fmt: skip
def test_a_camera_that_cannot_be_used_ends_the_start_with_one_line_that_says_what_to_do(
    station: CameraStation, library: Path, devices: Path, driver: dict[str, int], settings: dict[str, object],
    message: str,
) -> None:  # fmt: skip
    with fake.camera(library, devices, (Mode(),), **driver) as camera:
        default = {"device": str(camera.path)} if driver else {}
        options = {"devices": str(devices), **default, **settings.pop("options", {})}  # type: ignore[dict-item]
        station.start("uvc", environment=camera.environment, **{**SMALL, **settings}, options=options)
        code, line = station.ends()
    assert code == 1
    assert re.search(message, line), line


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"source": "uvcc"}, "unknown camera 'uvcc' (did you mean 'uvc'?); known: files, mujoco, realsense, uvc, zmq"),
        ({"options": {"devise": "x"}}, "unknown key 'devise' (did you mean 'device'?)"),
        ({"source": "files"}, "options of the source files: missing key path"),
        ({"fps": 0}, "fps is 0; expected 0.1 to 240 Hz"),
        ({"width": 5}, "width is 5; expected 16 to 8192 px"),
        ({"quality": 101}, "quality is 101; expected 1 to 100"),
        ({"depth": True}, "depth is true, and the source uvc gives none; those that do: mujoco, realsense"),
        ({"name": "head_depth"}, "name is 'head_depth', which is what the depth of a camera is called"),
        ({"name": "Head Cam"}, "name is 'Head Cam'; expected small letters, digits and _"),
    ],
)
def test_settings_that_cannot_be_are_refused_by_name(settings: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build(CameraConfig, settings, where="test")
    assert message in str(caught.value)
