"""What a simulated robot's cameras see: of which state, when, and exactly where in the picture."""

from __future__ import annotations

import time
from pathlib import Path

import mujoco
import numpy as np
import pytest

from adapters.cameras.kinds import MUJOCO, MujocoOptions
from adapters.cameras.mujoco_robot import MujocoCamera, intrinsics
from adapters.robots.g1.mujoco_g1 import START_Q, START_ROOT_POS
from adapters.robots.legged.unitree import GO2
from station import depth, rotations
from station.bus import codec
from station.bus import stamp as stamps
from station.bus.sample import Sample
from station.bus.stamp import Stamp
from station.camera.source import Camera, CameraError, PictureSettings
from station.optics import of_facts
from station.protocols import Floats
from tests.adapters.cameras import pictures

G1 = Path("adapters/robots/g1/g1.xml")
SMALL = PictureSettings(fps=200.0, width=160, height=120)


def standing(*, yaw_rad: float = 0.0, elbow_rad: float = 1.2) -> Floats:
    q = np.array(START_Q, dtype=float)
    q[18] = elbow_rad
    return np.concatenate([START_ROOT_POS, [np.cos(yaw_rad / 2), 0, 0, np.sin(yaw_rad / 2)], q])


class Bus:
    """What a watch would hold."""

    def __init__(self) -> None:
        self.sample: Sample | None = None

    def write(self, value: bytes, *, boot: str = "") -> int:
        now_ns = time.monotonic_ns()
        source = f"g1.1.{boot or stamps.boot_id()}.abcd"
        self.sample = Sample("key", value, Stamp(1, now_ns, 0, source), now_ns + 1000)
        return now_ns

    def newest(self, _key: str) -> Sample | None:
        return self.sample


def made(bus: Bus, camera: str = "head", model: str = str(G1), settings: PictureSettings = SMALL) -> MujocoCamera:
    try:
        return MujocoCamera(model, camera, "key", settings, bus.newest)
    except CameraError as error:
        if "cannot render" in str(error) or "no picture" in str(error):
            pytest.skip(str(error))
        raise


def picture_of(camera: MujocoCamera, bus: Bus, qpos: Floats) -> bytes:
    bus.write(codec.f64(qpos))
    picture = camera.read(5.0)
    assert picture is not None
    return picture.jpeg


def test_a_picture_is_of_the_newest_state_and_taken_when_that_was_written() -> None:
    bus = Bus()
    camera = made(bus)
    assert isinstance(camera, Camera)
    assert camera.read(1.0) is None
    assert camera.why_silent() == "key: nobody writes it; is the simulation running?"
    written_ns = bus.write(codec.f64(standing()))
    picture = camera.read(1.0)
    assert picture is not None
    assert picture.capture_ns == written_ns
    assert pictures.decoded(picture.jpeg).shape == (120, 160, 3)
    assert camera.read(1.0) is None, "a state gives one picture"
    camera.close()


def test_the_time_of_another_machine_is_not_taken_for_ours() -> None:
    bus = Bus()
    camera = made(bus)
    written_ns = bus.write(codec.f64(standing()), boot="00000000")
    picture = camera.read(1.0)
    assert picture is not None
    assert picture.capture_ns == written_ns + 1000
    camera.close()


def test_what_moves_shows_where_the_camera_looks() -> None:
    def difference(name: str, before: Floats, after: Floats) -> float:
        bus = Bus()
        camera = made(bus, name)
        first, second = (pictures.decoded(picture_of(camera, bus, qpos)) for qpos in (before, after))
        camera.close()
        return float(np.abs(first.astype(int) - second).mean())

    assert difference("head", standing(), standing(yaw_rad=0.5)) > 3.0
    assert difference("left_wrist", standing(), standing(elbow_rad=0.2)) > 3.0
    assert difference("right_wrist", standing(), standing(elbow_rad=0.2)) < 3.0


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (b"short", "key: "),
        (codec.f64(np.zeros(35)), "35 numbers, expected 36"),
        (codec.f64(np.full(36, np.nan)), "finite"),
    ],
)
def test_a_state_that_is_none_gives_no_picture_and_a_reason(value: bytes, told: str) -> None:
    bus = Bus()
    camera = made(bus)
    bus.write(value)
    assert camera.read(1.0) is None
    assert camera.drops.torn == 1
    assert told in camera.why_silent()
    camera.close()


def test_a_camera_that_the_model_has_not_is_refused_with_those_it_has() -> None:
    with pytest.raises(CameraError, match=r"no camera 'haed'; it has .*head.*left_wrist.*; set options.camera"):
        made(Bus(), "haed")


def test_intrinsics_say_to_the_pixel_where_a_point_is_seen(tmp_path: Path) -> None:
    """A small ball is put where it is drawn off the centre, and looked for in the picture."""
    spec = mujoco.MjSpec.from_file(str(G1))
    spec.add_material(name="beacon", rgba=[1, 0, 0, 1], emission=1.0)
    place = np.array([0.9, 0.25, 0.6])
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.012, 0, 0], pos=place, material="beacon",
                            contype=0, conaffinity=0)  # fmt: skip
    model = spec.compile()
    file = tmp_path / "scene.xml"
    file.write_text(spec.to_xml())
    bus, settings = Bus(), PictureSettings(fps=200.0, width=640, height=480, quality=98)
    camera = made(bus, model=str(file), settings=settings)
    shown = pictures.decoded(picture_of(camera, bus, standing())).astype(int)
    facts = camera.facts()
    camera.close()

    data = mujoco.MjData(model)
    data.qpos[:] = standing()
    mujoco.mj_forward(model, data)
    inner, mount = of_facts(facts)
    assert inner is not None
    assert mount is not None
    torso = data.body(mount.parent)
    seen_from = torso.xmat.reshape(3, 3).T @ (place - torso.xpos) - mount.position_m
    right, down, forward = rotations.rotate_inverse(mount.quat_wxyz, seen_from)
    expected = inner.cx + inner.fx * right / forward, inner.cy + inner.fy * down / forward
    rows, columns = np.nonzero(shown[:, :, 0] - shown[:, :, 1:].max(axis=2) > 60)
    assert len(rows) > 20
    np.testing.assert_allclose((columns.mean(), rows.mean()), expected, atol=0.5)
    assert mount.parent == "torso_link"


def test_depth_says_to_the_millimetre_how_far_the_floor_is_along_the_optical_axis() -> None:
    bus = Bus()
    camera = made(bus, settings=PictureSettings(fps=200.0, width=160, height=120, depth=True))
    bus.write(codec.f64(standing()))
    picture = camera.read(5.0)
    facts = camera.facts()
    camera.close()
    assert picture is not None
    steps = depth.decoded(picture.depth)
    assert steps is not None
    assert steps.shape == pictures.decoded(picture.jpeg).shape[:2], "a pixel of the one is that of the other"
    assert facts["depth"]["is_aligned"]
    farthest_m = facts["depth"]["range_m"][1]

    model = mujoco.MjModel.from_xml_path(str(G1))
    data = mujoco.MjData(model)
    data.qpos[:] = standing()
    mujoco.mj_forward(model, data)
    inner, mount = of_facts(facts)
    assert inner is not None
    assert mount is not None
    torso = data.body(mount.parent)
    turn = torso.xmat.reshape(3, 3)
    height_m = (torso.xpos + turn @ mount.position_m)[2]
    rows, columns = np.mgrid[0:120, 0:160]
    rays = np.stack([(columns - inner.cx) / inner.fx, (rows - inner.cy) / inner.fy, np.ones_like(rows, float)], axis=-1)
    down = -(rotations.rotate(mount.quat_wxyz, rays.reshape(-1, 3)) @ turn.T)[:, 2].reshape(rows.shape)
    expected_m = np.divide(height_m, down, where=down > 0.0, out=np.full(down.shape, np.inf))
    seen_m = depth.in_metres(steps, facts["depth"]["step_m"])
    floor = (expected_m > 0.8) & (expected_m < 3.0)
    assert floor.sum() > 3000
    wrong_m = np.abs(seen_m - expected_m)[floor]
    assert np.median(wrong_m) < 0.001
    assert np.percentile(wrong_m, 95) < 0.01, "but for the robot's own arms, where they are in view"
    assert (steps[expected_m > 1.1 * farthest_m] == 0).all(), "the sky, and what is too far"


def test_of_a_camera_without_depth_none_is_told() -> None:
    bus = Bus()
    camera = made(bus)
    bus.write(codec.f64(standing()))
    picture = camera.read(5.0)
    assert picture is not None
    assert picture.depth == b""
    assert "depth" not in camera.facts()
    camera.close()


def test_intrinsics_of_a_right_angle() -> None:
    inner = intrinsics(90.0, 640, 480)
    assert inner.fx == pytest.approx(240.0)
    assert (inner.cx, inner.cy) == (319.5, 239.5)


def test_a_robot_that_is_named_looks_from_its_own_model() -> None:
    bus = Bus()
    options = MujocoOptions(robot="go2")
    try:
        camera = MUJOCO.open(options, SMALL, bus.newest)
    except CameraError as error:
        pytest.skip(str(error))
    assert camera.facts()["model"].endswith("go2.xml")
    assert camera.facts()["follows"] == "sim_qpos_go2"
    bus.write(codec.f64(np.ones(36)))
    assert camera.read(1.0) is None
    assert camera.why_silent() == "sim_qpos_go2: 36 numbers, expected 19 finite ones"
    bus.write(codec.f64(np.concatenate([[0, 0, GO2.start_height_m, 1, 0, 0, 0], GO2.start_q])))
    assert camera.read(1.0) is not None
    camera.close()
