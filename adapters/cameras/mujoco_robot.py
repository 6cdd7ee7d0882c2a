"""What the cameras of a simulated robot on legs see: drawn in this process, from the state that it publishes.

The model is the simulation's, or any other with the same joints: another scene, or meshes, in pictures only. A picture
is of the newest state, and taken when that state was written; where no new state has come there is no new picture.
"""

from __future__ import annotations

import time
from typing import Any, Literal

import mujoco
import numpy as np

from adapters.cameras.encode import Encoder
from adapters.cameras.pace import Pace
from adapters.robots.legged import mjcf, unitree
from adapters.robots.legged.addresses import Addresses
from adapters.robots.legged.table import LeggedRobot
from adapters.robots.picture import Camera as Eye
from station import assets, depth
from station.bus import codec
from station.bus.sample import Sample
from station.camera.source import CameraError, Drops, Newest, Picture, PictureSettings
from station.contract import DEPTH_STEP_M
from station.errors import StationError
from station.optics import Intrinsics, Mount, Optics, from_opengl
from station.protocols import Floats

_SIZE, _FPS = (640, 480), 30.0
_MOST_PX = 4096
_FARTHEST_M = 10.0  # of depth, as stereo cameras have it; what is farther is 0


class MujocoCamera:
    """Draws what a camera of the model sees; implements `station.camera.source.Camera`.

    Args:
        model: MJCF file with the joints of the robot and the camera.
        camera: Name of the camera in the model.
        key: Key of the robot's true state.
        wishes: 640x480 at 30 Hz unless they say otherwise.
        newest: Gives the newest value of the key.
        is_fine: Whether to draw shadows and smooth edges, for a machine with a graphics card.
        robot: The robot.

    Raises:
        CameraError: the model has no such camera, or this machine cannot draw.
        BadFile: no such model.
    """

    def __init__(
        self, model: str, camera: str, key: str, settings: PictureSettings, newest: Newest, *, is_fine: bool = False,
        robot: LeggedRobot = unitree.G1,
    ) -> None:  # fmt: skip
        self.drops = Drops()
        self._path, self._name, self._key, self._newest = assets.resolve(model), camera, key, newest
        self._width, self._height = settings.width or _SIZE[0], settings.height or _SIZE[1]
        self._fps = settings.fps or _FPS
        self._pace, self._encoder = Pace(self._fps), Encoder(settings.quality)
        self._has_depth = settings.depth
        self._detail: Literal["fine", "plain"] = "fine" if is_fine else "plain"
        self._shown: Sample | None = None
        self._numbers = 7 + len(robot.joints)
        self._why_not = ""
        if max(self._width, self._height) > _MOST_PX:
            raise CameraError(f"camera {camera}: {self._width}x{self._height}; expected {_MOST_PX} px at most")
        self._model = mjcf.load(robot, self._path, is_drawn=True)
        if not is_fine:  # in software shadows take four fifths of the time, smooth edges half of the rest
            self._model.vis.quality.shadowsize = self._model.vis.quality.offsamples = 0
        self._at, self._data = Addresses(robot, self._model), mujoco.MjData(self._model)
        self._id = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
        if self._id < 0:
            known = ", ".join(self._model.camera(index).name for index in range(self._model.ncam)) or "none"
            raise CameraError(f"{self._path}: no camera {camera!r}; it has {known}; set options.camera")
        self._eye: Eye | None = None
        try:
            self._eye = Eye(self._model, self._width, self._height)
            self._eye.capture(
                self._pose(self._model.qpos0[[*self._at.root_q, *self._at.q]]), camera
            )  # the first is slow
        except StationError as error:
            raise CameraError(f"camera {camera}: {error}") from None

    def read(self, timeout_s: float) -> Picture | None:
        """Return a picture of the newest state; see `Camera.read`."""
        before = self._pace.index
        if self._pace.wait(timeout_s) is None:
            return None
        sample = self._newest(self._key)
        if sample is None or sample is self._shown or sample.arrived_ns is None:
            return None
        if self._shown is not None:
            self.drops.skipped += self._pace.index - before - 1
        self._shown = sample
        qpos = self._parsed(sample)
        if qpos is None or self._eye is None:
            return None
        pixels = self._eye.capture(self._pose(qpos), self._name)
        seen = b""
        if self._has_depth:
            seen = depth.encoded(depth.of_metres(self._eye.depth_m(), farthest_m=_FARTHEST_M))
        return Picture(self._encoder.rgb(pixels), _written_ns(sample), seen)

    def why_silent(self) -> str:
        """Return what is missing."""
        if self._why_not:
            return self._why_not
        return f"{self._key}: nobody writes it; is the simulation running?"

    def facts(self) -> dict[str, Any]:
        """Return model, camera, and what is known exactly of its optics."""
        model, camera = self._model, self._id
        return {
            "width": self._width,
            "height": self._height,
            "fps": self._fps,
            "format": "JPEG",
            "is_passed_through": False,
            "quality": self._encoder.quality,
            "device": f"MuJoCo camera {self._name}",
            "model": str(self._path),
            "model_sha256": assets.sha256(self._path),
            "detail": self._detail,
            "follows": self._key,
            "capture": "when the simulation wrote the state that the picture shows, monotonic clock",
            "exposure": {"is_auto": False, "time_s": 0.0},
            **Optics(
                intrinsics(float(model.cam_fovy[camera]), self._width, self._height),
                Mount(
                    parent=model.body(int(model.cam_bodyid[camera])).name,
                    position_m=tuple(model.cam_pos[camera].tolist()),
                    quat_wxyz=from_opengl(model.cam_quat[camera].tolist()),
                ),
            ).facts(),
            **({"depth": self._depth_facts()} if self._has_depth else {}),
            "library": f"mujoco {mujoco.__version__}",
        }

    def close(self) -> None:
        """Release the graphics memory."""
        eye, self._eye = self._eye, None
        if eye is not None:
            eye.close()

    def _depth_facts(self) -> dict[str, Any]:
        nearest_m = float(self._model.vis.map.znear * self._model.stat.extent)
        return {"step_m": DEPTH_STEP_M, "range_m": [round(nearest_m, 4), _FARTHEST_M], "is_aligned": True}

    def _parsed(self, sample: Sample) -> Floats | None:
        try:
            qpos = codec.parse_f64(sample.value)
        except codec.BadValue as error:
            self._refuse(str(error))
            return None
        if len(qpos) != self._numbers or not np.isfinite(qpos).all():
            self._refuse(f"{len(qpos)} numbers, expected {self._numbers} finite ones")
            return None
        self._why_not = ""
        return qpos

    def _refuse(self, why_not: str) -> None:
        self._why_not = f"{self._key}: {why_not}"
        self.drops.torn += 1

    def _pose(self, qpos: Floats) -> mujoco.MjData:
        """Put the model where a state says, shape (7 + n,), as far as one sees it."""
        data, at = self._data, self._at
        data.qpos[at.root_q], data.qpos[at.q] = qpos[:7], qpos[7:]
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_comPos(self._model, data)
        mujoco.mj_camlight(self._model, data)
        return data


def intrinsics(fovy_deg: float, width: int, height: int) -> Intrinsics:
    """Return what is known of a camera without distortion from its vertical field of view."""
    focal = 0.5 * height / float(np.tan(np.radians(0.5 * fovy_deg)))
    return Intrinsics(
        width=width, height=height, fx=focal, fy=focal, cx=0.5 * (width - 1), cy=0.5 * (height - 1),
        source=f"exact, from a vertical field of view of {fovy_deg:g} degrees",
    )  # fmt: skip


def _written_ns(sample: Sample) -> int:
    """Return when a state was written, on this machine's monotonic clock; when it arrived, where that is another's."""
    mark = sample.stamp
    if mark is not None and mark.is_from_this_boot:
        return mark.mono_ns
    return sample.arrived_ns if sample.arrived_ns is not None else time.monotonic_ns()
