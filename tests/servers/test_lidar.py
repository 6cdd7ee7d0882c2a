"""A lidar from end to end: a room that is seen by rays, DDS, the bus, the recorder, and points that are right."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from servers.lidar import LidarConfig
from station.api.episode import open_episode
from station.api.live import Station
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.config import build
from station.episode.recorder import remote
from station.errors import ConfigError, StationError, UnknownName, UsageError
from station.point_cloud import PointCloud, decoded
from tests.dds_domains import domain
from tests.servers.lidar_station import MOUNT, LidarStation, lidar_station, recorder
from tests.waiting import wait_until

IMU_KEY = keys.lidar_imu("top")


@pytest.fixture
def lidar(bus_server: BusAddress, tmp_path: Path) -> Iterator[LidarStation]:
    with lidar_station("top", bus_server, tmp_path) as made:
        yield made


class Sender:
    """A lidar on a domain of its own; what it sends, the test says."""

    def __init__(self) -> None:
        from adapters.lidars import dds_types
        from adapters.lidars.options import DdsOptions
        from adapters.robots.g1.dds.network import Network, raw
        from adapters.robots.g1.dds.options import NetworkOptions

        self._held = contextlib.ExitStack()
        number = self._held.enter_context(domain())
        self.options = {"domain": number}
        network = self._held.enter_context(Network(NetworkOptions(domain=number)))
        topics = DdsOptions()
        self.cloud = network.writer(topics.cloud, raw(dds_types.PointCloud2)).write
        self.imu = network.writer(topics.imu, raw(dds_types.Imu)).write
        self.close = self._held.close


@pytest.fixture
def sender(processes: None) -> Iterator[Sender]:
    pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")
    made = Sender()
    yield made
    made.close()


def begin(lidar: LidarStation, sender: Sender, message: Callable[[], bytes], **settings: object) -> None:
    """Start the server, and send until its first cloud is on the bus: by then both have found each other."""
    lidar.start("dds", options=sender.options, **settings)
    lidar.until_active()

    def hears() -> bool:
        sender.cloud(message())
        return bool(lidar.shots)

    lidar.until(hears)
    count = -1
    while count != len(lidar.shots):  # what was sent meanwhile has come
        count = len(lidar.shots)
        time.sleep(0.3)
        lidar.until(lambda: True)


def test_every_cloud_is_kept_byte_for_byte_and_points_are_in_the_frame_of_the_mount(
    lidar: LidarStation, sender: Sender, bus_server: BusAddress, tmp_path: Path
) -> None:
    from adapters.lidars.room import Room
    from adapters.lidars.ros_messages import Imu, write_cloud, write_imu

    room, sent = Room(3_000), list[PointCloud]()
    with recorder(bus_server, tmp_path / "data"), Bus(bus_server, name="test", timeout_s=5.0) as bus:
        begin(lidar, sender, lambda: write_cloud(room.cloud(1)), mount=MOUNT)
        wait_until(lambda: bus.get(keys.RECORDER) is not None)
        folder = Path(remote.ask(bus, "start", task="look").path or "")
        for number in range(12):
            before = len(lidar.shots)
            sent.append(room.cloud(1_000_000_000 + number))
            for part in range(5):
                sender.imu(write_imu(Imu((number, part, 0.5), (0.0, 0.0, -9.81), 1), "livox_frame"))
            sender.cloud(write_cloud(sent[-1]))
            lidar.until(lambda before=before: len(lidar.shots) > before)
        with Station(bus_server.url) as lab:
            live = lab.cloud("top", max_age_s=60.0)
            assert lab.cloud("elsewhere") is None
            assert lab.cloud("top", max_age_s=-1.0) is None
            assert len(lab.cloud("top", max_age_s=60.0, most=50)) == 50
            bus.publish({keys.lidar_cloud("bad"): b"no cloud"})
            with pytest.raises(UsageError, match="lidar_cloud_bad: no point cloud"):
                lab.cloud("bad", max_age_s=60.0)
        remote.ask(bus, "stop")
    on_the_bus = [decoded(shot.jpeg) for shot in lidar.shots[-12:]]
    assert [(bytes(one.data), one.sensor_ns) for one in on_the_bus] == [(one.data, one.sensor_ns) for one in sent]
    episode = open_episode(folder)
    assert episode.lidars == ["bad", "top"]
    kept = [decoded(data) for _, data in episode.raw(keys.lidar_cloud("top"))]
    assert [(bytes(cloud.data), cloud.frame) for cloud in kept] == [(cloud.data, "torso_link") for cloud in sent]
    clouds = list(episode.clouds("top"))
    assert len(clouds) == 12
    for _, points in clouds:
        is_floor = np.abs(points[:, 2] - room.floor_m) < 0.1
        assert points[is_floor, 2].mean() == pytest.approx(room.floor_m, abs=0.03)
    assert (np.asarray(live) == clouds[-1][1]).all()
    assert np.diff([at_s for at_s, _ in clouds]).min() > 0
    imu = episode.numpy(IMU_KEY)
    assert imu.names[:3] == ("gyro_x", "gyro_y", "gyro_z")
    assert [tuple(row[:2]) for row in imu.values] == [(number, part) for number in range(12) for part in range(5)]
    assert lidar.facts["key"] == keys.lidar_cloud("top")
    assert [field["name"] for field in lidar.facts["fields"]][:4] == ["x", "y", "z", "intensity"]
    with pytest.raises(StationError, match=r"holds clouds, no numbers; episode.clouds\('top'\) reads it"):
        episode.numpy(keys.lidar_cloud("top"))
    with pytest.raises(UnknownName, match="top"):
        list(episode.clouds("tip"))
    with pytest.warns(UserWarning, match="lidar bad: the cloud of"):
        assert list(episode.clouds("bad")) == []


def test_what_is_refused_or_comes_too_fast_is_counted_and_a_silent_lidar_is_told_of(
    lidar: LidarStation, sender: Sender
) -> None:
    from adapters.lidars.room import Room
    from adapters.lidars.ros_messages import write_cloud

    good = write_cloud(Room(500).cloud(1))
    begin(lidar, sender, lambda: good)
    lidar.until(lambda: lidar.told("lidar-lost"))
    assert "writes it, and nothing comes" in lidar.told("lidar-lost")[-1].detail["reason"]
    sender.cloud(good.replace(b"x\0", b"u\0", 1))
    lidar.until(lambda: lidar.detail.get("torn") == 1)
    lidar.until(lambda: "no field x; it has u, y, z" in lidar.told("lidar-lost")[-1].detail["reason"])

    def is_live() -> bool:
        sender.cloud(good)  # a lidar that sent but one would be lost again before the heartbeat says so
        return lidar.detail.get("lidar") == "live"

    lidar.until(is_live)
    assert lidar.told("lidar-back")
    assert lidar.detail["points"] == 500
    lidar.until(lambda: lidar.detail.get("clouds") == len(lidar.shots))
    assert lidar.detail["kilobytes"] is None or lidar.detail["kilobytes"] > 13.0
    assert lidar.stop() == 0


def test_where_nobody_sends_the_reason_says_so(lidar: LidarStation, sender: Sender) -> None:
    lidar.start("dds", options={**sender.options, "cloud": "rt/elsewhere"})
    lidar.until(lambda: lidar.told("lidar-lost"))
    assert "rt/elsewhere: nobody writes it on lo, domain" in lidar.told("lidar-lost")[0].detail["reason"]


def test_an_interface_that_is_not_there_ends_the_server_with_what_to_do(lidar: LidarStation, sender: Sender) -> None:
    lidar.start("dds", options={**sender.options, "interface": "none0"})
    code, words = lidar.ends()
    assert code != 0
    assert "'none0': DDS cannot use it" in words


def test_rays_need_no_network(lidar: LidarStation) -> None:
    lidar.start("rays", options={"points": 2_000}, mount=MOUNT)
    lidar.until(lambda: len(lidar.shots) >= 3)
    cloud = decoded(lidar.shots[-1].jpeg)
    assert (cloud.frame, cloud.points) == ("torso_link", 2_000)
    lidar.until(lambda: lidar.detail.get("clouds"))
    assert lidar.stop() == 0


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"source": "sonar"}, "sonar"),
        ({"name": "Top!"}, "expected small letters"),
        ({"niceness": 40}, "expected 0 to 19"),
        ({"options": {"domain": 300}}, "expected 0 to 230"),
        ({"options": {"speed": 1}}, "speed"),
        ({"mount": {"parent": ""}}, "parent is empty"),
        ({"source": "rays", "options": {"points": 0}}, "expected 1 to 1000000"),
    ],
)
def test_settings_that_cannot_be_are_refused_by_name(settings: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        build(LidarConfig, settings, where="settings")
