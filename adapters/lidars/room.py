"""A room around a robot as a lidar in its head sees it: rays in MuJoCo, with the layout and the faults of a MID-360.

The sensor hangs upside down, as in a G1: its own z points to the floor. About 30 % of its points are exact zeros, where
nothing came back; ranges have a noise of 2 cm; arms and shoulders are seen, the shell that it looks through is not.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from adapters.robots.g1 import mujoco_g1
from station import rotations
from station.point_cloud import PointCloud, PointField, SensorPose
from station.protocols import Floats

POINTS, RATE_HZ = 20_000, 10.0
FRAME = "livox_frame"
BODY = "torso_link"
POSITION_M = (0.0003, 0.0, 0.416)
RPY_RAD = (0.0, 3.101, 3.1415)
"""Of the sensor in the torso; fitted on one robot's gantry by a lab, so check it on yours: docs/lidar.md."""

FIELDS = (
    PointField("x", 0, "<f4"), PointField("y", 4, "<f4"), PointField("z", 8, "<f4"), PointField("intensity", 12, "<f4"),
    PointField("tag", 16, "u1"), PointField("line", 17, "u1"), PointField("timestamp", 18, "<f8"),
)  # fmt: skip
STRIDE = 26
"""Of livox_ros_driver2: not aligned."""

GRAVITY = 9.81
_LOWEST_DEG, _HIGHEST_DEG = -7.0, 52.0
_FARTHEST_M = 40.0
_LOST, _NOISE_M = 0.3, 0.02
_LINES = 4
_SHELL_M = 0.2  # parts of the robot whose centre is nearer than that are what the sensor looks through
_SHELL_GROUP = 5
_MODEL = Path(mujoco_g1.__file__).with_name("g1.xml")
_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))
_DTYPE = np.dtype({
    "names": [field.name for field in FIELDS], "formats": [field.type for field in FIELDS],
    "offsets": [field.offset for field in FIELDS], "itemsize": STRIDE,
})  # fmt: skip


class Room:
    """A robot that stands in a room of boxes, and the lidar in its head.

    Args:
        points: Of a cloud.
        seed: Of boxes, noise, and what is lost.
        chair_m: Where a chair stands, x and y [m].

    Attributes:
        floor_m: Height of the floor in the torso's frame [m].
    """

    def __init__(self, points: int = POINTS, *, seed: int = 0, chair_m: tuple[float, float] = (1.5, 0.5)) -> None:
        self._random = np.random.default_rng(seed)
        self._model = _furnished(self._random, chair_m)
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:7] = *mujoco_g1.START_ROOT_POS, 1.0, 0.0, 0.0, 0.0
        mujoco.mj_forward(self._model, self._data)
        torso = self._data.body(BODY)
        self._at = torso.xpos + rotations.rotate(torso.xquat, np.array(POSITION_M))
        turn = rotations.multiply(torso.xquat, rotations.from_roll_pitch_yaw(RPY_RAD))
        self._rays = _spiral(points)
        self._world_rays = rotations.rotate(turn, self._rays)
        self._down = rotations.rotate_inverse(turn, np.array([0.0, 0.0, GRAVITY]))
        self.floor_m = -float(torso.xpos[2])
        near = np.linalg.norm(self._data.geom_xpos - self._at, axis=1) < _SHELL_M
        self._model.geom_group[near & (self._model.geom_bodyid > 0)] = _SHELL_GROUP
        self._groups = np.array([group != _SHELL_GROUP for group in range(6)], np.uint8)

    def cloud(self, sensor_ns: int) -> PointCloud:
        """Return what the sensor sees, ending at an instant of its clock [ns]."""
        count = len(self._rays)
        hit, ranges = np.empty(count, np.int32), np.empty(count)
        mujoco.mj_multiRay(
            self._model, self._data, self._at, self._world_rays.ravel(), self._groups, True, -1, hit, ranges, None,
            count, _FARTHEST_M,
        )  # fmt: skip
        is_lost = (hit < 0) | (self._random.random(count) < _LOST)
        ranges = np.where(is_lost, 0.0, ranges + self._random.normal(0.0, _NOISE_M, count))
        rows = np.zeros(count, _DTYPE)
        for axis, column in zip("xyz", (self._rays * ranges[:, None]).T, strict=True):
            rows[axis] = column
        rows["intensity"] = np.where(is_lost, 0, 10 + hit % 90)
        rows["line"] = np.arange(count) % _LINES
        rows["timestamp"] = sensor_ns - (count - np.arange(count)) * (1e9 / RATE_HZ / count)
        return PointCloud(FRAME, SensorPose(), STRIDE, FIELDS, rows.tobytes(), sensor_ns)

    def imu(self) -> tuple[Floats, Floats]:
        """Return what its IMU says: angular velocity [rad/s], acceleration [m/s^2]; with noise."""
        noise = self._random.normal(0.0, 1.0, (2, 3))
        return 0.002 * noise[0], self._down + 0.02 * noise[1]


def _furnished(random: np.random.Generator, chair_m: tuple[float, float]) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_file(str(_MODEL))
    for x, y, half in ((4.0, 0.0, (0.1, 4.0, 1.5)), (-4.0, 0.0, (0.1, 4.0, 1.5)),
                       (0.0, 4.0, (4.0, 0.1, 1.5)), (0.0, -4.0, (4.0, 0.1, 1.5))):  # fmt: skip
        _add_box(spec, (x, y), half)
    for _ in range(30):
        angle, away = random.uniform(0.0, 2.0 * np.pi), random.uniform(2.2, 3.7)
        size = random.uniform((0.05, 0.05, 0.1), (0.25, 0.25, 0.6))
        _add_box(spec, (away * np.cos(angle), away * np.sin(angle)), tuple(size))
    _add_box(spec, chair_m, (0.2, 0.2, 0.45))
    return spec.compile()


def _add_box(spec: mujoco.MjSpec, at_m: tuple[float, float], half_m: tuple[float, ...]) -> None:
    """Put a box on the floor."""
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=list(half_m), pos=[*at_m, half_m[2]], contype=0, conaffinity=0
    )


def _spiral(count: int) -> NDArray[np.float64]:
    """Return directions that fill the field of view evenly, shape (n, 3)."""
    low, high = np.sin(np.radians([_LOWEST_DEG, _HIGHEST_DEG]))
    up = low + (high - low) * (np.arange(count) + 0.5) / count
    flat, angle = np.sqrt(1.0 - up * up), _GOLDEN * np.arange(count)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), up], axis=1)
