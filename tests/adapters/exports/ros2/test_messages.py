from __future__ import annotations

import re

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from adapters.exports.jointstate import SCHEMA_NAME, JointStates
from adapters.exports.ros2 import messages, ros_types
from station import point_cloud
from station.point_cloud import PointCloud, PointField, SensorPose
from tests.adapters.exports.ros2.read_back import HUMBLE

TYPES = sorted(
    value for value in vars(messages).values() if isinstance(value, str) and re.match(r"\w+/msg/\w+$", value)
)


@pytest.mark.parametrize("store", [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY, Stores.ROS2_KILTED])
def test_the_types_are_the_same_in_every_release_so_no_option_is_needed(store: Stores) -> None:
    others = get_typestore(store)
    assert len(TYPES) == 13
    for name in TYPES:
        text, digest = ros_types.definition(name)
        assert (others.generate_msgdef(name, ros_version=2)[0], others.hash_rihs01(name)) == (text, digest)


@pytest.mark.parametrize("joints", [("a",), ("abc", "d"), ("ab", "cdefg", "h")])
@pytest.mark.parametrize("holds", ["pve", "pe", "p"])
def test_joint_states_that_are_laid_out_by_hand_are_what_rosbags_makes(joints: tuple[str, ...], holds: str) -> None:
    count = len(joints)
    places = [list(range(at * count, at * count + count)) if part in holds else [] for at, part in enumerate("pve")]
    values = [float(number) for number in range(3 * count)]
    made = JointStates(joints, places).encode(values, 5_000_000_007)
    arrays = [np.array([values[one] for one in each]) for each in places]
    assert made == ros_types.cdr(ros_types.make(SCHEMA_NAME, ros_types.header(5_000_000_007), list(joints), *arrays))


@pytest.mark.parametrize("names", [(), ("a",), ("left_knee", "right_knee"), ("a", "bc", "def")])
def test_rows_of_numbers_are_read_back_whatever_their_columns_are_called(names: tuple[str, ...]) -> None:
    made, width = messages.NumberArrays(names), len(names) or 2
    for rows in (1, 3, 1):
        table = np.random.default_rng(rows).normal(size=(rows, width))
        read = HUMBLE.deserialize_cdr(made.encode(table), messages.NUMBERS)
        assert read.data.tolist() == table.ravel().tolist()
        sizes = [one.size for one in read.layout.dim]
        assert (np.prod(sizes), sizes[:2]) == (table.size, [rows, width])
        strides = [int(np.prod(sizes[number:])) for number in range(len(sizes))]
        assert [one.stride for one in read.layout.dim] == strides


def test_a_vector_of_nothing_is_an_array_of_nothing() -> None:
    made = messages.NumberArrays(())
    read = HUMBLE.deserialize_cdr(made.encode(messages.table([], 0)), messages.NUMBERS)
    assert read.data.tolist() == []


def test_every_type_of_a_field_of_a_cloud_has_its_number_in_ros() -> None:
    kinds = [np.dtype(name) for name in point_cloud.TYPES]
    offsets = np.cumsum([12, *(kind.itemsize for kind in kinds)]).tolist()
    axes = [PointField(axis, 4 * number, "<f4") for number, axis in enumerate("xyz")]
    others = [PointField(f"f{at}", at, name) for at, name in zip(offsets, point_cloud.TYPES, strict=False)]
    stride = offsets[-1]
    data = np.random.default_rng(0).integers(0, 255, 2 * stride, dtype=np.uint8).tobytes()
    cloud = PointCloud("x", SensorPose(), stride, (*axes, *others), data)
    read = HUMBLE.deserialize_cdr(messages.cloud(0, "lidar", cloud), messages.CLOUD)
    numbers = {"int8": 1, "uint8": 2, "int16": 3, "uint16": 4, "int32": 5, "uint32": 6, "float32": 7, "float64": 8}
    assert [one.datatype for one in read.fields[3:]] == [numbers[kind.name] for kind in kinds]
    assert (read.point_step, read.width, read.data.tobytes()) == (stride, 2, data)
