"""The simulated lidar against what a lab tells of a real one, and the check that a robot must pass (R27)."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.lidars import room
from adapters.lidars.options import RaysOptions
from adapters.lidars.rays import RaysLidar
from station import rotations
from station.lidar.source import Lidar
from station.point_cloud import PointCloud, SensorPose, records, voxels, xyz
from station.protocols import Floats32


def mounted(cloud: PointCloud) -> PointCloud:
    """Return a cloud as the server publishes it: in the torso's frame."""
    turn = tuple(rotations.from_roll_pitch_yaw(room.RPY_RAD).tolist())
    return cloud._replace(frame=room.BODY, pose=SensorPose(room.POSITION_M, turn))


def floor_of(points: Floats32, floor_m: float) -> tuple[float, float]:
    """Return height [m] and tilt [rad] of the plane through the points near the floor."""
    near = points[(np.abs(points[:, 2] - floor_m) < 0.15) & (np.abs(points[:, :2]) < 3.5).all(axis=1)]
    assert len(near) > 500
    plane, *_ = np.linalg.lstsq(np.c_[near[:, :2], np.ones(len(near))], near[:, 2], rcond=None)
    return float(plane[2]), float(np.hypot(*plane[:2]))


@pytest.fixture(scope="module")
def seen() -> PointCloud:
    return room.Room(seed=1).cloud(5_000_000_000)


def test_a_cloud_has_the_layout_and_the_faults_of_a_mid_360(seen: PointCloud) -> None:
    assert (seen.stride, seen.points, seen.frame) == (26, 20_000, "livox_frame")
    assert [(field.name, field.offset) for field in seen.fields][-2:] == [("line", 17), ("timestamp", 18)]
    rows = records(seen)
    is_zero = (rows["x"] == 0) & (rows["y"] == 0) & (rows["z"] == 0)
    assert 0.28 < is_zero.mean() < 0.45
    assert set(rows["line"]) == {0, 1, 2, 3}
    assert np.ptp(rows["timestamp"]) == pytest.approx(0.1e9, rel=1e-3)


def test_the_sensor_hangs_upside_down_and_sees_shoulders(seen: PointCloud) -> None:
    raw = xyz(seen)
    assert raw[:, 2].max() == pytest.approx(1.3, abs=0.2), "the floor is where its own z points"
    assert 0.0 < (np.linalg.norm(raw, axis=1) < 0.3).mean() < 0.1
    assert np.linalg.norm(raw, axis=1).min() > 0.03, "its own shell is not in the way"


def test_after_the_mounts_transform_the_floor_is_a_plane_within_3_cm(seen: PointCloud) -> None:
    made = room.Room(seed=1)
    height_m, tilt_rad = floor_of(xyz(mounted(seen)), made.floor_m)
    assert height_m == pytest.approx(made.floor_m, abs=0.03)
    assert tilt_rad < 0.01


def test_without_the_mount_the_floor_is_nowhere_near(seen: PointCloud) -> None:
    assert (xyz(seen)[:, 2] < -0.7).mean() < 0.05


def test_a_chair_that_was_moved_by_a_metre_is_seen() -> None:
    def near(at: tuple[float, float], chair_m: tuple[float, float]) -> int:
        points = voxels(xyz(mounted(room.Room(seed=1, chair_m=chair_m).cloud(0))))
        is_near = (np.abs(points[:, :2] - at) < 0.3).all(axis=1) & (points[:, 2] > -0.75)
        return int(is_near.sum())

    before, after = (1.5, 0.5), (1.5, -0.5)
    assert near(before, chair_m=before) > 30 > 5 * near(after, chair_m=before)
    assert near(after, chair_m=after) > 30 > 5 * near(before, chair_m=after)


def test_the_imu_at_rest_feels_gravity_along_its_negative_z() -> None:
    samples = np.array([room.Room(seed=seed).imu()[1] for seed in range(3)])
    assert samples[:, 2] == pytest.approx(-room.GRAVITY, abs=0.2)


def test_the_source_of_rays_is_a_lidar_that_needs_no_network(monkeypatch: pytest.MonkeyPatch) -> None:
    lidar = RaysLidar(RaysOptions(points=200))
    assert isinstance(lidar, Lidar)
    assert lidar.facts()["fields"] is None
    scan = lidar.read(0.0)
    assert scan is not None
    assert scan.cloud.points == 200
    assert lidar.facts()["frame"] == "livox_frame"
    assert len(lidar.imu()) >= 1
    lidar.close()
