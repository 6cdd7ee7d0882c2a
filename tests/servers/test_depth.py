"""Depth from end to end: a simulated eye, the bus, the recorder, and metres that are right when they are read back."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import mujoco
import numpy as np
import pytest

import station
from adapters.robots.g1 import twist_keys
from adapters.robots.g1.mujoco_g1 import START_Q, START_ROOT_POS
from adapters.robots.picture import Camera as Eye
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.recorder import remote
from station.errors import StationError
from tests.servers.camera_station import CameraStation, camera_station
from tests.waiting import wait_until

SIZE = {"width": 160, "height": 120}
QPOS = keys.sim_qpos(twist_keys.TWIST2_ROBOT)
LOOKS_DOWN_M = 1.25
"""How far the floor is below the camera of this test, which looks straight down [m]."""


@pytest.fixture
def camera(bus_server: BusAddress, tmp_path: Path) -> Iterator[CameraStation]:
    with camera_station("floor", bus_server, tmp_path) as made:
        yield made


@pytest.fixture(scope="module")
def eyes() -> None:
    """Skip where this machine cannot draw at all."""
    try:
        Eye(mujoco.MjModel.from_xml_string("<mujoco/>"), 64, 48).close()
    except StationError as error:
        pytest.skip(str(error))


def scene(folder: Path) -> Path:
    """A G1, a camera of the world that looks straight down on the floor, and a box of 0.3 m below it."""
    spec = mujoco.MjSpec.from_file("adapters/robots/g1/g1.xml")
    spec.worldbody.add_camera(name="floor", pos=[5.0, 0.0, LOOKS_DOWN_M], fovy=60.0)
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.15], pos=[5.0, 0.0, 0.15], contype=0, conaffinity=0
    )
    spec.compile()
    file = folder / "scene.xml"
    file.write_text(spec.to_xml())
    return file


def test_what_a_simulated_eye_measures_is_read_back_in_metres(
    eyes: None, camera: CameraStation, bus_server: BusAddress, tmp_path: Path
) -> None:
    settings = {"data": str(tmp_path / "data"), "min_free_mb": 0, "preroll_s": 0}
    command = [sys.executable, "-m", "station", "serve", "recorder", "--bus", bus_server.url, "--config-json",
               msgspec.json.encode(settings).decode()]  # fmt: skip
    recorder = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    try:
        with Bus(bus_server, name="g1", timeout_s=5.0) as bus:
            camera.start(
                "mujoco", fps=30, depth=True, **SIZE, options={"camera": "floor", "model": str(scene(tmp_path))}
            )
            camera.until_active()
            wait_until(lambda: bus.get(keys.RECORDER) is not None)
            folder = Path(remote.ask(bus, "start", task="look").path or "")
            qpos = np.concatenate([START_ROOT_POS, [1.0, 0.0, 0.0, 0.0], START_Q])

            camera.until(lambda: bus.publish({QPOS: codec.f64(qpos)}) and len(camera.shots) >= 5)
            remote.ask(bus, "stop")
    finally:
        recorder.terminate()
        recorder.wait()
    episode = station.open_episode(folder)
    assert episode.depth_cameras == ["floor"]
    pictures, depths = list(episode.pictures("floor")), list(episode.depth("floor"))
    assert len(depths) >= 5
    assert [time_s for time_s, _ in depths] == [time_s for time_s, _ in pictures], "of the same moments"
    for _, metres in depths:
        assert metres.shape == (120, 160)
        assert metres[5:20, 5:20] == pytest.approx(LOOKS_DOWN_M, abs=0.001)
        assert metres[60, 80] == pytest.approx(LOOKS_DOWN_M - 0.3, abs=0.001)
    quality = episode.check()
    assert [(one.name, one.torn.count) for one in quality.pictures] == [("floor", 0), ("floor_depth", 0)]
    (beside, _) = episode.manifest.cameras
    assert (beside["key"], beside["step_m"], beside["range_m"][1]) == (keys.camera_depth("floor"), 0.001, 10.0)
