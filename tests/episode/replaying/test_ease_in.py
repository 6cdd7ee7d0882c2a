"""The way into the first command of a replay: an arm is led there from where it is, no faster than it should."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.robots.g1 import twist_keys
from station import registry
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.tap import open_tap
from station.episode.reading.reader import EpisodeReader, open_episode
from station.episode.replaying.replay import ease_in
from tests.episode.arm_run import ROBOT, ArmRun
from tests.episode.synthetic import EpisodeBuilder


@pytest.fixture
def reader(tmp_path: Path) -> EpisodeReader:
    made = ArmRun(EpisodeBuilder(tmp_path, task="jog"))
    made.move(0.1)
    return open_episode(made.finish())


def first_command(reader: EpisodeReader) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return codec.parse_json_vector(next(iter(reader.messages({keys.action_joints(ROBOT)}))).data)


def test_an_arm_is_led_from_where_it_is_at_a_fifth_of_a_radian_a_second(
    reader: EpisodeReader, bus_server: BusAddress
) -> None:
    tap = open_tap(bus_server)
    start = first_command(reader) - np.array([0, 0.06, 0, 0, 0, 0, 0])
    with Bus(bus_server, name="replay", timeout_s=5.0) as bus:
        bus.publish({keys.command_used(ROBOT): codec.f64(start)})
        assert ease_in(bus, reader, 0.1) == pytest.approx(0.3)
    writes = [write for _ in range(3) for write in tap.read(0.2) if write.key == keys.action_joints(ROBOT)]
    tap.close()
    way = np.array([codec.parse_json_vector(write.value or b"") for write in writes])
    np.testing.assert_array_equal(way[0], start)
    assert len(way) == 15
    assert np.abs(np.diff(way, axis=0)).max() <= 0.2 / 50 + 1e-9


def test_an_arm_that_nobody_drives_there_is_led_nowhere(reader: EpisodeReader, bus_server: BusAddress) -> None:
    with Bus(bus_server, name="replay", timeout_s=5.0) as bus:
        assert ease_in(bus, reader, 1.0) == 0.0


def test_commands_that_begin_together_are_led_in_together(tmp_path: Path, bus_server: BusAddress) -> None:
    builder = EpisodeBuilder(tmp_path, task="both")
    made = ArmRun(builder)
    standing = registry.find("command", "twist2").default
    builder.write({twist_keys.action_body(): codec.json_vector(standing + 0.01)}, at_s=0.01, writer="motion")
    made.move(0.1)
    reader, tap = open_episode(made.finish()), open_tap(bus_server)
    with Bus(bus_server, name="replay", timeout_s=5.0) as bus:
        bus.publish({keys.command_used(ROBOT): codec.f64(first_command(reader))})
        assert ease_in(bus, reader, 0.2) == pytest.approx(0.2)
    written = [write.key for _ in range(3) for write in tap.read(0.2) if not keys.is_stamp(write.key)]
    tap.close()
    assert written.count(keys.action_joints(ROBOT)) == written.count(twist_keys.action_body()) == 10


def test_a_velocity_that_an_episode_begins_with_is_led_in_from_standing(tmp_path: Path, bus_server: BusAddress) -> None:
    key = "action_velocity_go2"
    builder = EpisodeBuilder(tmp_path, task="walk")
    for tick in range(5):
        builder.write({key: codec.json_vector([0.6, 0.0, -0.3])}, at_s=0.1 + 0.02 * tick, writer="motion")
    reader = open_episode(builder.finish({"servers": {"robot": {"robot": "go2"}}}))
    tap = open_tap(bus_server)
    with Bus(bus_server, name="replay", timeout_s=5.0) as bus:
        assert ease_in(bus, reader, 0.2) == pytest.approx(0.2)
    way = [codec.parse_json_vector(write.value or b"") for _ in range(3) for write in tap.read(0.2) if write.key == key]
    tap.close()
    assert len(way) == 10
    np.testing.assert_array_equal(way[0], np.zeros(3))
    np.testing.assert_allclose(way[-1], [0.54, 0.0, -0.27])
