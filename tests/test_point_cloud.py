from __future__ import annotations

import numpy as np
import pytest

from station import rotations
from station.episode.storage import layout
from station.episode.storage.bulk import value_in
from station.episode.storage.pictures import time_before
from station.point_cloud import (
    FARTHEST_M,
    BadCloud,
    PointCloud,
    PointField,
    SensorPose,
    decoded,
    encoded,
    records,
    voxels,
    xyz,
)
from station.protobuf import foxglove, schema

PACKED = (
    PointField("x", 0, "<f4"), PointField("y", 4, "<f4"), PointField("z", 8, "<f4"), PointField("intensity", 12, "<f4"),
    PointField("tag", 16, "u1"), PointField("line", 17, "u1"), PointField("timestamp", 18, "<f8"),
)  # fmt: skip
HERE = SensorPose()


def made(points: list[list[float]], pose: SensorPose = HERE, fields: tuple[PointField, ...] = PACKED, stride: int = 26):
    layout = np.dtype({
        "names": [field.name for field in fields], "formats": [field.type for field in fields],
        "offsets": [field.offset for field in fields], "itemsize": stride,
    })  # fmt: skip
    rows = np.zeros(len(points), layout)
    for axis, column in zip("xyz", np.asarray(points, np.float64).reshape(-1, 3).T, strict=True):
        rows[axis] = column
    return PointCloud("torso", pose, stride, fields, rows.tobytes(), 123_456_789_012)


def test_a_cloud_comes_back_byte_for_byte_with_its_fields_its_frame_and_its_time() -> None:
    cloud = made([[1, 2, 3], [4, 5, 6]], SensorPose((0.1, 0.2, 0.3), (0.0, 1.0, 0.0, 0.0)))
    found = decoded(encoded(cloud))
    assert found._replace(data=bytes(found.data)) == cloud
    assert found.points == 2


def test_foxglove_reads_the_same_from_it() -> None:
    cloud = made([[1, 2, 3]], SensorPose((0.1, 0.2, 0.3), (0.5, 0.5, -0.5, 0.5)))
    kind = schema.message_class(foxglove.schema(foxglove.POINT_CLOUD))
    read = kind.FromString(time_before(1_500_000_000_000_000_007) + encoded(cloud))
    assert (read.timestamp.seconds, read.timestamp.nanos) == (1_500_000_000, 7)
    assert (read.frame_id, read.point_stride, read.data) == ("torso", 26, cloud.data)
    assert [(one.name, one.offset, one.type) for one in read.fields][-2:] == [("line", 17, 1), ("timestamp", 18, 8)]
    assert (read.pose.position.z, read.pose.orientation.w, read.pose.orientation.y) == (0.3, 0.5, -0.5)
    assert (read.sensor_time.seconds, read.sensor_time.nanos) == (123, 456_789_012)


def test_the_time_of_a_file_is_taken_off_again() -> None:
    value = encoded(made([[1, 2, 3]]))
    assert value_in(time_before(5) + value, layout.CLOUDS) == value
    for bad in (b"", value, b"\x0a\x09"):
        with pytest.raises(ValueError, match=r"time|beyond"):
            value_in(bad, layout.CLOUDS)


def test_points_without_a_return_and_numbers_that_are_none_are_left_out() -> None:
    cloud = made([[0, 0, 0], [1, 2, 3], [np.nan, 0, 1], [np.inf, 0, 0], [2 * FARTHEST_M, 0, 0], [0, 0, 0.5]])
    assert xyz(cloud).tolist() == [[1, 2, 3], [0, 0, 0.5]]
    assert xyz(cloud).dtype == np.float32


def test_points_are_told_in_the_frame_of_the_mount() -> None:
    upside_down = SensorPose((0.0, 0.0, 1.3), tuple(rotations.from_roll_pitch_yaw([np.pi, 0.0, 0.0]).tolist()))
    np.testing.assert_allclose(xyz(made([[1.0, 2.0, 1.3]], upside_down)), [[1.0, -2.0, 0.0]], atol=1e-6)


def test_a_choice_of_many_points_is_the_same_for_the_same_seed() -> None:
    cloud = made([[index + 1, 0, 0] for index in range(1000)])
    first, again, other = xyz(cloud, most=100), xyz(cloud, most=100), xyz(cloud, most=100, seed=1)
    assert first.shape == (100, 3)
    assert (first == again).all()
    assert (np.diff(first[:, 0]) > 0).all()
    assert (first != other).any()


def test_doubles_and_padded_records_are_read_by_their_table() -> None:
    fields = (PointField("z", 8, "<f8"), PointField("x", 16, "<f8"), PointField("y", 24, "<f8"))
    assert xyz(made([[1, 2, 3], [1e300, 0, 0]], fields=fields, stride=48)).tolist() == [[1, 2, 3]]
    assert records(made([[1, 2, 3]]))["z"].tolist() == [3.0]


@pytest.mark.parametrize(
    ("cloud", "said"),
    [
        (PointCloud("", HERE, 26, PACKED, b"\0" * 27), "no whole number of points"),
        (PointCloud("", HERE, 0, PACKED, b""), "points of 0 bytes"),
        (PointCloud("", HERE, 20, PACKED, b""), "timestamp ends at byte 26"),
        (PointCloud("", HERE, 26, PACKED[1:], b""), "no field x"),
        (PointCloud("", HERE, 26, (*PACKED, PACKED[0]), b""), "same name"),
    ],
)
def test_a_cloud_that_does_not_hold_together_is_refused_in_words(cloud: PointCloud, said: str) -> None:
    with pytest.raises(BadCloud, match=said):
        encoded(cloud)


def test_random_bytes_and_damaged_clouds_are_refused_or_read_and_never_crash() -> None:
    random, value = np.random.default_rng(0), bytearray(encoded(made([[1, 2, 3]] * 4, SensorPose((0.0, 0.0, 1.0)))))
    for _ in range(5_000):
        data = bytearray(value)
        for place in random.integers(0, len(data), size=random.integers(1, 4)):
            data[place] = random.integers(0, 256)
        for one in (bytes(data), bytes(data[: random.integers(0, len(data))]), random.bytes(40)):
            try:
                points = xyz(decoded(one))
            except BadCloud:
                continue
            assert np.isfinite(points).all()


def test_a_voxel_keeps_the_first_of_its_points() -> None:
    points = np.array([[0.01, 0.01, 0.01], [0.02, 0.0, 0.0], [0.06, 0.0, 0.0], [-0.01, 0.0, 0.0]], np.float32)
    assert voxels(points).tolist() == points[[0, 2, 3]].tolist()
    assert len(voxels(np.empty((0, 3), np.float32))) == 0
    edge = np.array([[FARTHEST_M] * 3, [-FARTHEST_M] * 3], np.float32)
    assert len(voxels(edge, 0.01)) == 2
    with pytest.raises(ValueError, match="or more"):
        voxels(points, 0.001)
