"""PointCloud2 as it comes: any table of fields, either byte order, padded rows; and what is no cloud, refused."""

from __future__ import annotations

import numpy as np
import pytest

from adapters.lidars.room import FIELDS, STRIDE
from adapters.lidars.ros_messages import Imu, parse_cloud, parse_imu, write_cloud, write_imu
from station.point_cloud import BadCloud, PointCloud, PointField, SensorPose, decoded, encoded, records, xyz

PADDED = (
    PointField("x", 0, "<f4"), PointField("y", 4, "<f4"), PointField("z", 8, "<f4"), PointField("intensity", 16, "<f4"),
    PointField("ring", 20, "<u2"), PointField("time", 24, "<f8"),
)  # fmt: skip


def cloud(count: int = 6, fields: tuple[PointField, ...] = FIELDS, stride: int = STRIDE, *, order: str = "<"):
    layout = np.dtype({
        "names": [field.name for field in fields], "formats": [field.type.replace("<", order) for field in fields],
        "offsets": [field.offset for field in fields], "itemsize": stride,
    })  # fmt: skip
    rows = np.zeros(count, layout)
    for number, field in enumerate(fields):
        rows[field.name] = np.arange(count) + 10 * number
    return PointCloud("sensor", SensorPose(), stride, fields, rows.tobytes(), 1_700_000_000_123_456_789)


@pytest.mark.parametrize(("fields", "stride"), [(FIELDS, STRIDE), (PADDED, 32)])
def test_table_and_bytes_are_those_of_the_message(fields: tuple[PointField, ...], stride: int) -> None:
    sent = cloud(fields=fields, stride=stride)
    found = parse_cloud(write_cloud(sent))
    assert found._replace(data=bytes(found.data)) == sent
    assert isinstance(found.data, memoryview), "not copied"


def test_a_time_before_the_epoch_is_left_out() -> None:
    found = parse_cloud(write_cloud(cloud()._replace(sensor_ns=-5)))
    assert found.sensor_ns == -5
    assert decoded(encoded(found)).sensor_ns is None


def test_big_endian_numbers_are_turned_and_mean_the_same() -> None:
    big = cloud(order=">")
    found = parse_cloud(write_cloud(big, is_big=True))
    assert found.data == cloud().data
    assert records(found)["timestamp"].tolist() == records(cloud())["timestamp"].tolist()


def test_rows_that_are_padded_lose_their_padding() -> None:
    found = parse_cloud(write_cloud(cloud(), width=3, padding=5))
    assert found.data == cloud().data


def test_a_field_of_several_numbers_becomes_as_many_fields() -> None:
    message = bytearray(write_cloud(cloud()))
    at = message.index(b"intensity")
    count_at = at + 20  # name of ten bytes, two of padding, offset, type, three of padding
    assert message[count_at : count_at + 4] == b"\x01\0\0\0"
    message[at + 12 : at + 16] = (0).to_bytes(4, "little")
    message[count_at] = 3
    names = [field.name for field in parse_cloud(bytes(message)).fields]
    assert names[3:6] == ["intensity_0", "intensity_1", "intensity_2"]


def test_a_message_in_the_other_byte_order_is_read() -> None:
    little = write_imu(Imu((1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 7), "")
    body = bytearray()
    at, numbers = 4, [4, 4, 4]
    for size in numbers:  # stamp and length of the frame
        body += little[at : at + size][::-1]
        at += size
    body += little[at : at + 4]  # an empty name, and padding
    body += np.frombuffer(little[at + 4 :], "<f8").astype(">f8").tobytes()
    assert parse_imu(b"\x00\x00\x00\x00" + bytes(body)) == parse_imu(little)


def test_the_imu_is_read_as_it_was_written() -> None:
    sample = Imu((0.1, -0.2, 0.3), (0.0, 0.5, -9.8), 1_700_000_000_123_456_789)
    assert parse_imu(write_imu(sample, "livox_frame")) == sample
    with pytest.raises(BadCloud, match="truncated"):
        parse_imu(write_imu(sample, "livox_frame")[:-80])


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda data: data[:-20], "truncated: 156 bytes are told of"),
        (lambda data: b"\x00\x07" + data[2:], "does not begin as XCDR1 does"),
        (lambda data: b"", "a message of 0 bytes"),
        (lambda data: data.replace(b"x\0", b"u\0", 1), "no field x"),
        (lambda data: data.replace((26).to_bytes(4, "little"), (20).to_bytes(4, "little"), 1), "ends at byte 26"),
        (lambda data: data.replace((156).to_bytes(4, "little"), (150).to_bytes(4, "little"), 1), "row_step is 150"),
    ],
)
def test_what_is_no_whole_cloud_is_refused_in_words(spoil, said: str) -> None:
    with pytest.raises(BadCloud, match=said):
        parse_cloud(spoil(write_cloud(cloud())))


def test_more_rows_than_came_are_refused() -> None:
    message = write_cloud(cloud(), width=3)
    height = message.index((2).to_bytes(4, "little") + (3).to_bytes(4, "little"))
    with pytest.raises(BadCloud, match="truncated: 9 rows of 78 bytes"):
        parse_cloud(message[:height] + (9).to_bytes(4, "little") + message[height + 4 :])


@pytest.mark.parametrize("seed", range(4))
def test_damaged_and_random_bytes_never_crash(seed: int) -> None:
    random, sound = np.random.default_rng(seed), write_cloud(cloud(), width=3, padding=2)
    for _ in range(4_000):
        data = bytearray(sound)
        for place in random.integers(0, len(data), size=random.integers(1, 5)):
            data[place] = random.integers(0, 256)
        for one in (bytes(data), bytes(data[: random.integers(0, len(data))]), b"\0\1\0\0" + random.bytes(60)):
            for parse in (parse_cloud, parse_imu):
                try:
                    found = parse(one)
                except BadCloud:
                    continue
                if isinstance(found, PointCloud):
                    assert np.isfinite(xyz(found)).all()
