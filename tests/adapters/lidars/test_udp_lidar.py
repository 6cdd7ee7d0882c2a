"""A Livox lidar's own packets: read as they are sent, put together to clouds, and refused where they are none."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator

import numpy as np
import pytest

from adapters.lidars import livox_packets as packets
from adapters.lidars.options import UdpOptions
from adapters.lidars.room import Room
from adapters.lidars.udp_lidar import UdpLidar
from station.lidar.source import Lidar, LidarError
from station.point_cloud import BadCloud, PointCloud, records, xyz

HOST = "127.0.0.1"
FRAME_NS = 100_000_000


def free_ports() -> tuple[int, int]:
    held = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    for one in held:
        one.bind((HOST, 0))
    first, second = (one.getsockname()[1] for one in held)
    for one in held:
        one.close()
    return first, second


class Link:
    """A lidar that is heard, and the line on which a test sends to it."""

    def __init__(self, **options: object) -> None:
        self.points, self.samples = free_ports()
        self.lidar = UdpLidar(UdpOptions(address=HOST, point_port=self.points, imu_port=self.samples, **options))
        self._line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send(self, data: bytes, port: int | None = None) -> None:
        self._line.sendto(data, (HOST, port or self.points))

    def close(self) -> None:
        self.lidar.close()
        self._line.close()


@pytest.fixture
def link() -> Iterator[Link]:
    made = Link()
    yield made
    made.close()


@pytest.fixture(scope="module")
def frames() -> list[PointCloud]:
    room = Room(1920)
    return [room.cloud((number + 1) * FRAME_NS) for number in range(3)]


def test_a_packet_is_laid_out_as_livox_says(frames: list[PointCloud]) -> None:
    first = next(packets.write_points(frames[0]))
    assert len(first) == 36 + 96 * 14
    version, length, interval, points, count = struct.unpack_from("<BHHHH", first)
    assert (version, length, interval, points, count) == (0, 1380, round(96 * FRAME_NS / 1920 / 100), 96, 0)
    frame, kind, clock = first[9:12]
    assert (frame, kind, clock) == (0, 1, 0)
    assert struct.unpack_from("<Q", first, 28)[0] == int(records(frames[0])["timestamp"][0])
    x_mm = struct.unpack_from("<i", first, 36)[0]
    assert x_mm == round(float(records(frames[0])["x"][0]) * 1e3)
    assert len(packets.write_imu([0.0] * 6, 0, 1)) == 60


@pytest.mark.parametrize(("kind", "within_m"), [(packets.MILLIMETRES, 0.0006), (packets.CENTIMETRES, 0.006)])
def test_the_cloud_of_a_frame_is_that_of_its_points(kind: int, within_m: float, frames: list[PointCloud]) -> None:
    sent = frames[0]
    found = packets.cloud_of([packets.parse(data) for data in packets.write_points(sent, kind=kind)])
    assert (found.stride, found.fields, found.points) == (sent.stride, sent.fields, sent.points)
    for axis in "xyz":
        np.testing.assert_allclose(records(found)[axis], records(sent)[axis], atol=within_m)
    np.testing.assert_allclose(records(found)["timestamp"], records(sent)["timestamp"], atol=200)
    assert abs(len(xyz(found)) - len(xyz(sent))) <= 1
    assert found.sensor_ns == pytest.approx(records(sent)["timestamp"][-1], abs=200)


def test_a_frame_is_given_when_the_next_one_begins(link: Link, frames: list[PointCloud]) -> None:
    assert isinstance(link.lidar, Lidar)
    for data in packets.write_points(frames[0]):
        link.send(data)
    assert link.lidar.read(0.02) is None
    assert link.lidar.facts()["fields"] is None
    for data in packets.write_points(frames[1]):
        link.send(data)
    scan = link.lidar.read(0.5)
    assert scan is not None
    np.testing.assert_allclose(records(scan.cloud)["z"], records(frames[0])["z"], atol=0.0006)
    assert link.lidar.facts()["frame"] == "livox_frame"
    assert link.lidar.drops.total == 0


def test_of_two_frames_that_waited_the_newer_is_given_and_lost_packets_are_counted(
    link: Link, frames: list[PointCloud]
) -> None:
    for number, frame in enumerate(frames):
        for count, data in enumerate(packets.write_points(frame)):
            if number or count not in (3, 4):
                link.send(data)
    scan = link.lidar.read(0.5)
    assert scan is not None
    assert scan.cloud.points == 1920
    assert scan.cloud.sensor_ns == pytest.approx(2 * FRAME_NS, abs=FRAME_NS / 1900)
    assert (link.lidar.drops.skipped, link.lidar.drops.lost, link.lidar.drops.torn) == (1, 2, 0)


def test_the_imu_is_told_in_metres_and_radians_with_its_own_spacing(link: Link) -> None:
    for number in range(4):
        link.send(packets.write_imu([0.1, 0.2, 0.3, 0.0, 0.0, -1.0], number, number * 5_000_000), link.samples)
    found = link.lidar.imu()
    assert [len(one.values) for one in found] == [6] * 4
    assert found[0].values == pytest.approx([0.1, 0.2, 0.3, 0.0, 0.0, -9.80665])
    assert np.diff([one.capture_ns for one in found]).tolist() == [5_000_000] * 3
    link.send(packets.write_imu([np.nan] * 6, 5, 5), link.samples)
    assert link.lidar.imu() == []
    assert link.lidar.drops.torn == 1


def test_what_is_no_packet_is_counted_and_said(link: Link, frames: list[PointCloud]) -> None:
    assert "nothing comes" in link.lidar.why_silent()
    good = next(packets.write_points(frames[0]))
    of_another_type = good[:10] + b"\x03" + good[11:]
    told = ((b"hello", "a packet of 5 bytes"), (good[:-1], "says that it has 1380"), (of_another_type, "type 3"))
    for data, said in told:
        link.send(data)
        assert link.lidar.read(0.02) is None
        assert said in link.lidar.why_silent()
    assert link.lidar.drops.torn == 3


def test_of_others_than_the_lidar_that_is_named_nothing_is_heard(frames: list[PointCloud]) -> None:
    made = Link(lidar="192.168.123.120")
    for frame in frames:
        for data in packets.write_points(frame):
            made.send(data)
    assert made.lidar.read(0.05) is None
    made.close()


def test_an_address_that_is_not_ours_and_a_port_that_is_taken_are_refused(link: Link) -> None:
    with pytest.raises(LidarError, match="no other program has"):
        UdpLidar(UdpOptions(address=HOST, point_port=link.points, imu_port=link.samples))
    with pytest.raises(LidarError, match="`ip -br address`"):
        UdpLidar(UdpOptions(address="203.0.113.7"))


def test_random_datagrams_never_crash() -> None:
    random = np.random.default_rng(0)
    sound = [next(packets.write_points(Room(1920).cloud(FRAME_NS))), packets.write_imu([0.1] * 6, 0, 1)]
    for number in range(10_000):
        data = bytearray(sound[number % 2])
        for place in random.integers(0, 40, size=3):
            data[place] = random.integers(0, 256)
        try:
            packet = packets.parse(bytes(data[: random.integers(30, len(data) + 1)] if number % 5 == 0 else data))
            found = packets.imu_of(packet) if packet.type == packets.IMU else packets.cloud_of([packet])
        except BadCloud:
            continue
        if isinstance(found, PointCloud):
            assert np.isfinite(xyz(found)).all()
