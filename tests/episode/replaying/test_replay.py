"""Replaying to a bus: the same bytes in the same order at the recorded instants, and no robot moved by accident."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import numpy as np
import pytest

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.tap import Tap, Write, open_tap
from station.episode.reading.reader import EpisodeReader, open_episode
from station.episode.replaying.replay import Replay, moments, to_bus
from station.errors import BusError, Refused, UnknownName, UsageError
from station.life.server import Health
from tests.episode.filming import WRIST, Scene, film
from tests.episode.synthetic import ROBOT, EpisodeBuilder, command, tick, walk
from tests.virtual.clock import VirtualClock
from tests.virtual.network import Network
from tests.waiting import wait_until

FAST = math.inf


@pytest.fixture
def builder(tmp_path: Path) -> EpisodeBuilder:
    return EpisodeBuilder(tmp_path)


@pytest.fixture
def tap(bus_server: BusAddress) -> Iterator[Tap]:
    tap = open_tap(bus_server)
    yield tap
    tap.close()


def episode(builder: EpisodeBuilder) -> EpisodeReader:
    return open_episode(builder.finish())


def seen(tap: Tap, count: int) -> list[Write]:
    """Everything that the tap sees, until there is nothing more."""
    writes: list[Write] = []
    deadline = time.monotonic() + 30.0
    while len(writes) < count and time.monotonic() < deadline:
        writes += tap.read(0.2)
    return writes + tap.read(0.1)


def test_same_bytes_in_the_same_order(builder: EpisodeBuilder, bus_server: BusAddress, tap: Tap) -> None:
    walk(builder, seconds=1.0)
    builder.foreign("unheard_of", b"\x00\xff not text", at_s=1.2)
    builder.event("mark", at_s=1.3)
    reader = episode(builder)
    report = to_bus(reader, bus_server, speed=FAST)
    recorded = [(message.topic, message.data) for message in reader.messages()]
    assert [(write.key, write.value) for write in seen(tap, len(recorded))] == recorded
    assert (report.messages, report.lost, report.skipped, report.is_complete) == (len(recorded), 0, 0, True)


def test_pictures_are_written_byte_for_byte_between_the_signals_where_they_were(
    tmp_path: Path, bus_server: BusAddress, tap: Tap
) -> None:
    scene = Scene()
    writes = [write for _ in range(5) for write in (*scene.signals(2), scene.picture(), scene.picture(WRIST))]
    film(tmp_path / "e", [writes[:7], writes[7:]], scene.anchor)
    report = to_bus(open_episode(tmp_path / "e"), bus_server, speed=FAST)
    assert (report.messages, report.lost) == (len(writes), 0)
    assert [(write.key, write.value) for write in seen(tap, len(writes))] == [(w.key, w.value) for w in writes]


def test_native_keys_get_a_fresh_stamp_of_the_replay_and_foreign_ones_none(
    builder: EpisodeBuilder, bus_server: BusAddress, tap: Tap
) -> None:
    tick(builder, 1, at_s=0.1)
    builder.foreign(twist_keys.T_ACTION, b"1", at_s=0.2)
    to_bus(episode(builder), bus_server, speed=FAST)
    writes = {write.key: write for write in seen(tap, 12)}
    assert writes[twist_keys.T_ACTION].stamp is None
    stamp = writes[keys.policy_obs(ROBOT)].stamp
    assert stamp is not None
    assert b" replay." in stamp


def test_one_recorded_command_stays_one(builder: EpisodeBuilder, bus_server: BusAddress) -> None:
    tick(builder, 1, at_s=0.1)
    builder.foreign(twist_keys.T_ACTION, b"1", at_s=0.2)
    reader = episode(builder)
    report = Replay(episode_id="", bus="", roles=[], speed=1.0)
    found = list(moments(reader, None, report))
    assert [len(moment.values) for moment in found] == [2, 3, 6, 1]
    with Bus(bus_server, name="probe", timeout_s=5.0) as bus:
        to_bus(reader, bus_server, speed=FAST)
        marks = {bus.read([key])[key].stamp.mono_ns for key in found[2].values}  # type: ignore[union-attr]
    assert len(marks) == 1


def test_deleted_keys_are_deleted_again(builder: EpisodeBuilder, bus_server: BusAddress) -> None:
    builder.foreign("key", b"1", at_s=0.1)
    builder.delete("key", at_s=0.2)
    with Bus(bus_server, name="probe", timeout_s=5.0) as bus:
        bus.call("SET", "key", "0")
        to_bus(episode(builder), bus_server, speed=FAST)
        assert bus.get("key") is None


@pytest.mark.parametrize("speed", [0.5, 1.0, 4.0])
def test_time_line_is_the_recorded_one_at_any_speed(builder: EpisodeBuilder, speed: float) -> None:
    instants = [0.0, 0.3, 0.4, 1.6, 1.7]
    for number, at_s in enumerate(instants):
        builder.foreign("key", b"%d" % number, at_s=at_s)
    with VirtualClock() as clock:
        network = Network(clock)
        report = to_bus(episode(builder), network.address(), speed=speed)
        written = [(at_ns * 1e-9, value) for at_ns, key, value in network.server.journal if key == b"key"]
    assert [value for _, value in written] == [b"0", b"1", b"2", b"3", b"4"]
    np.testing.assert_allclose([at_s - written[0][0] for at_s, _ in written], np.array(instants) / speed, atol=1e-6)
    assert report.seconds == pytest.approx(instants[-1] / speed, abs=0.1)
    assert report.lateness_p50_s <= report.lateness_p99_s <= report.lateness_max_s < 1e-3


def test_replay_ends_when_asked_to(builder: EpisodeBuilder, bus_server: BusAddress) -> None:
    builder.foreign("key", b"1", at_s=0.0)
    builder.foreign("key", b"2", at_s=3600.0)
    stop = threading.Event()
    with Bus(bus_server, name="probe", timeout_s=5.0) as bus, ThreadPoolExecutor(1) as pool:
        running = pool.submit(to_bus, episode(builder), bus_server, stop=stop)
        wait_until(lambda: bus.get("key") == b"1")
        stop.set()
        report = running.result(timeout=30.0)
    assert (report.messages, report.is_complete) == (1, False)


def test_only_the_named_roles_are_replayed(builder: EpisodeBuilder, bus_server: BusAddress, tap: Tap) -> None:
    walk(builder, seconds=0.2)
    report = to_bus(episode(builder), bus_server, speed=FAST, roles=["command"])
    assert {write.key for write in seen(tap, 20)} == {twist_keys.action_body(), keys.command_source(ROBOT)}
    assert report.skipped > 0


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan])
def test_speed_that_is_none_is_refused(builder: EpisodeBuilder, bus_server: BusAddress, speed: float) -> None:
    with pytest.raises(UsageError, match="expected a positive number"):
        to_bus(episode(builder), bus_server, speed=speed)


def test_unknown_role_is_refused_with_the_known_ones(builder: EpisodeBuilder, bus_server: BusAddress) -> None:
    with pytest.raises(UnknownName, match="did you mean 'command'"):
        to_bus(episode(builder), bus_server, roles=["commands"])


def test_bus_that_is_not_there_is_one_line(builder: EpisodeBuilder, tmp_path: Path) -> None:
    with pytest.raises(BusError):
        to_bus(episode(builder), BusAddress(socket=str(tmp_path / "none.sock")))


class Alive:
    """A server that says it is alive, as `station.life.server` does."""

    def __init__(self, address: BusAddress, role: str, name: str) -> None:
        self._bus = Bus(address, name=name, timeout_s=5.0)
        now = time.time_ns()
        health = Health(
            name=name, role=role, state="active", pid=1, host="here", boot="", source=self._bus.source,  # type: ignore[arg-type]
            started_wall_ns=now, wall_ns=now + 60_000_000_000,
        )  # fmt: skip
        self._bus.publish({keys.server(name): msgspec.json.encode(health)})

    def close(self) -> None:
        self._bus.close()


@pytest.fixture
def robot(bus_server: BusAddress) -> Iterator[Alive]:
    alive = Alive(bus_server, "low-level", "g1")
    yield alive
    alive.close()


@pytest.mark.usefixtures("robot")
def test_a_driven_robot_is_not_moved_unless_allowed(builder: EpisodeBuilder, bus_server: BusAddress) -> None:
    walk(builder, seconds=0.1)
    with pytest.raises(Refused, match="a robot is driven on this bus \\(g1\\)"):
        to_bus(episode(builder), bus_server)


@pytest.mark.usefixtures("robot")
def test_a_driven_robot_gets_commands_only_and_is_eased_in(
    builder: EpisodeBuilder, bus_server: BusAddress, tap: Tap
) -> None:
    first = command(height=0.7)
    for number in range(5):
        tick(builder, number, at_s=0.02 * number, asked=first)
    report = to_bus(episode(builder), bus_server, allow_live=True, ease_in_s=0.2)
    writes = seen(tap, 20)
    assert {write.key for write in writes} == {twist_keys.action_body(), keys.command_source(ROBOT)}
    heights = [
        codec.parse_json_vector(write.value or b"")[2] for write in writes if write.key == twist_keys.action_body()
    ]
    assert report.eased_in_s == pytest.approx(0.2)
    assert len(heights) == 10 + 5
    assert heights[0] == pytest.approx(0.8)
    assert np.abs(np.diff(heights)).max() < 0.011
    assert heights[-5:] == [0.7] * 5


@pytest.mark.usefixtures("robot")
def test_a_driven_robot_is_not_hurried_and_gets_no_states(builder: EpisodeBuilder, bus_server: BusAddress) -> None:
    walk(builder, seconds=0.1)
    reader = episode(builder)
    with pytest.raises(Refused, match="expected at most 1"):
        to_bus(reader, bus_server, allow_live=True, speed=2.0)
    with pytest.raises(Refused, match="only commands"):
        to_bus(reader, bus_server, allow_live=True, roles=["command", "state"])


def test_stock_robot_without_heartbeat_is_heard_by_its_writes(builder: EpisodeBuilder, bus_server: BusAddress) -> None:
    walk(builder, seconds=0.1)
    stop = threading.Event()

    def stock() -> None:
        with Bus(bus_server, name="unused", timeout_s=5.0) as bus:
            while not stop.wait(0.02):
                bus.call("SET", twist_keys.state_body(ROBOT), codec.json_vector([0.0] * 34))

    writer = threading.Thread(target=stock)
    writer.start()
    try:
        with pytest.raises(Refused, match="a robot is driven"):
            to_bus(episode(builder), bus_server)
    finally:
        stop.set()
        writer.join()


def test_no_second_commander_beside_a_live_one(builder: EpisodeBuilder, bus_server: BusAddress, robot: Alive) -> None:
    walk(builder, seconds=0.1)
    motion = Alive(bus_server, "command", "motion")
    with pytest.raises(Refused, match="motion is writing commands"):
        to_bus(episode(builder), bus_server, allow_live=True)
    motion.close()


def test_recorded_requests_do_not_command_a_live_recorder(
    builder: EpisodeBuilder, bus_server: BusAddress, tap: Tap
) -> None:
    builder.write({keys.RECORD: b'{"action": "start"}'}, at_s=0.1, writer="cli")
    builder.write({twist_keys.T_ACTION: b"1"}, at_s=0.2, writer="motion")
    recorder = Alive(bus_server, "recorder", "recorder")
    seen(tap, 1)
    report = to_bus(episode(builder), bus_server, speed=FAST)
    assert [write.key for write in seen(tap, 1)] == [twist_keys.T_ACTION]
    assert report.skipped == 1
    recorder.close()


def test_heartbeats_of_a_replay_are_not_taken_for_servers(builder: EpisodeBuilder, bus_server: BusAddress) -> None:
    health = Health(
        name="g1", role="low-level", state="active", pid=1, host="here", boot="", source="g1.1.aa.bb",
        started_wall_ns=0, wall_ns=time.time_ns() + 60_000_000_000,
    )  # fmt: skip
    builder.write({keys.server("g1"): msgspec.json.encode(health)}, at_s=0.1)
    reader = episode(builder)
    assert to_bus(reader, bus_server, speed=FAST).is_complete
    assert to_bus(reader, bus_server, speed=FAST).is_complete
