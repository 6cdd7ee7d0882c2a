"""The SONIC bridge over real sockets: what it passes on, what it refuses, and a robot that nobody commands any more."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import zmq

from adapters.commands.twist2 import FORMAT
from adapters.sonic.message import pack, parse
from adapters.sonic.planner import IDLE, SLOW_WALK, Order, Planned, order_of, pack_order, pack_planned, planned_of
from adapters.sonic.pose import StreamedPose, frame_of
from servers.sonic import SonicConfig
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.config import build
from station.errors import ConfigError
from tests.servers.bridge_station import BridgeStation, Writer, free_port
from tests.waiting import wait_until

WALK_KEY = keys.action("velocity_g1_29")
AHEAD = (1.0, 0.0, 0.0)
WALKS = pack_planned(Planned(SLOW_WALK, AHEAD, AHEAD, 0.5))
START, STOP = (pack_order(Order(start=on, stop=not on, is_planner=True)) for on in (True, False))


@pytest.fixture
def bridge(bus_server: BusAddress, tmp_path: Path) -> Iterator[BridgeStation]:
    with contextlib.closing(BridgeStation("sonic", bus_server, tmp_path)) as made:
        yield made


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="commander", timeout_s=5.0) as client:
        yield client


class Theirs:
    """A socket of SONIC's programs, plain ZeroMQ."""

    def __init__(self, kind: int, address: str) -> None:
        self._socket = zmq.Context.instance().socket(kind)
        self._socket.setsockopt(zmq.LINGER, 0)
        if kind == zmq.PUB:
            self._socket.bind(address)
        else:
            self._socket.setsockopt(zmq.SUBSCRIBE, b"")
            self._socket.connect(address)
        self.orders: list[Order] = []
        self.plans: list[Planned] = []
        self.frames: list[np.ndarray] = []

    def send(self, *messages: bytes) -> None:
        for message in messages:
            self._socket.send(message)

    def hear(self) -> None:
        """Keep what has come."""
        with contextlib.suppress(zmq.Again):
            while True:
                data = self._socket.recv(zmq.NOBLOCK)
                if data.startswith(b"command"):
                    self.orders.append(order_of(parse("command", data)))
                elif data.startswith(b"planner"):
                    self.plans.append(planned_of(parse("planner", data)))
                else:
                    self.frames.append(frame_of(parse("pose", data)).q)

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def address() -> str:
    return f"tcp://127.0.0.1:{free_port()}"


@pytest.fixture
def commander(address: str) -> Iterator[Theirs]:
    with contextlib.closing(Theirs(zmq.PUB, address)) as made:
        yield made


@pytest.fixture
def robot(address: str) -> Iterator[Theirs]:
    with contextlib.closing(Theirs(zmq.SUB, address)) as made:
        yield made


# -- Their commander, our robot --------------------------------------------------------------------------------------
def sends(bridge: BridgeStation, commander: Theirs, *messages: bytes, until: Callable[[], object]) -> None:
    """Send messages again and again until something holds."""

    def holds() -> object:
        commander.send(*messages)
        return until()

    bridge.until(holds)


def test_plans_are_commands_on_the_bus_and_nothing_is_written_once_they_cease(
    bridge: BridgeStation, commander: Theirs, address: str
) -> None:
    bridge.start(mode="their-commander", address=address)
    sends(bridge, commander, WALKS, until=lambda: len(bridge.written[WALK_KEY]) > 20)
    assert bridge.vectors(WALK_KEY)[-1] == pytest.approx([0.5, 0.0, 0.0])
    assert set(bridge.written) - {keys.command_source("g1_29")} == {WALK_KEY}
    bridge.until(lambda: bridge.told("sonic-silent") and not bridge.detail["topics"]["planner"]["live"])
    assert bridge.told("sonic-live")[0].detail["sender"] == address
    count = len(bridge.written[WALK_KEY])
    assert bridge.detail["topics"]["planner"]["passed"] == count
    assert len(bridge.written[WALK_KEY]) == count
    sends(bridge, commander, WALKS, until=lambda: bridge.told("sonic-back"))
    assert bridge.interrupt() == 0
    assert bridge.told("teleop-commands-end")


def test_a_stop_of_theirs_lasts_until_their_start(bridge: BridgeStation, commander: Theirs, address: str) -> None:
    bridge.start(mode="their-commander", address=address)
    sends(bridge, commander, WALKS, until=lambda: bridge.written[WALK_KEY])
    sends(bridge, commander, STOP, WALKS, until=lambda: bridge.told("sonic-stopped"))
    other = pack_order(Order(start=False, stop=False, is_planner=True))
    sends(bridge, commander, other, WALKS,
          until=lambda: bridge.detail["topics"]["planner"]["dropped"].get("ordered-not-to", 0) > 20)  # fmt: skip
    count = len(bridge.written[WALK_KEY])
    sends(bridge, commander, START, WALKS, until=lambda: len(bridge.written[WALK_KEY]) > count)
    assert len(bridge.told("sonic-stopped")) == 1


def test_a_stream_that_their_commander_has_not_chosen_is_not_followed(
    bridge: BridgeStation, commander: Theirs, address: str
) -> None:
    bridge.start(mode="their-commander", address=address)
    posed = pack_order(Order(start=True, stop=False, is_planner=False))
    sends(bridge, commander, posed, WALKS, until=lambda: bridge.detail["topics"]["planner"]["dropped"])
    assert bridge.told("sonic-ordered")[0].detail["reason"] == "their commander chose the pose stream"
    assert WALK_KEY not in bridge.written


def test_what_cannot_be_said_as_a_velocity_is_told(bridge: BridgeStation, commander: Theirs, address: str) -> None:
    bridge.start(mode="their-commander", address=address)
    crawls = pack_planned(Planned(8, AHEAD, AHEAD))
    sends(bridge, commander, crawls, until=lambda: bridge.told("sonic-refused"))
    assert "no-meaning: mode 8 has no meaning" in bridge.told("sonic-refused")[0].detail["reason"]
    assert WALK_KEY not in bridge.written
    said = dict(parse("planner", WALKS).fields) | {"vr_position": np.zeros(9, np.float32)}
    sends(bridge, commander, pack("planner", 1, said), until=lambda: bridge.told("sonic-left-out"))
    assert bridge.told("sonic-left-out")[0].detail["fields"] == ["vr_position"]
    bridge.until(lambda: bridge.written[WALK_KEY])


def test_ten_thousand_damaged_messages_reach_no_key_and_end_nothing(
    bridge: BridgeStation, commander: Theirs, address: str
) -> None:
    bridge.start(mode="their-commander", address=address)
    rng = random.Random(5)
    sends(bridge, commander, b"planner{", until=lambda: bridge.detail["topics"]["planner"]["dropped"])
    for number in range(10_000):
        data = bytearray(rng.choice([WALKS, START]))
        for _ in range(rng.randint(1, 4)):
            data[rng.randrange(300)] ^= 1 << rng.randrange(8)  # not the numbers: each of them is one
        commander.send(bytes(data[: rng.choice([len(data), rng.randrange(len(data))])]))
        if number % 500 == 0:
            bridge.until(lambda: True)
    dropped = bridge.detail["topics"]["planner"]["dropped"]
    bridge.until(lambda: bridge.detail["topics"]["planner"]["dropped"] != dropped)
    for vector in bridge.vectors(WALK_KEY):
        assert vector in ([0.5, 0.0, 0.0], [0.4, 0.0, 0.0]), "a bit of no meaning, or of the name of the speed"
    sends(bridge, commander, START, WALKS, until=lambda: len(bridge.written[WALK_KEY]) > 0)


def test_what_waited_while_the_bridge_stood_still_is_refused_as_stale(
    bridge: BridgeStation, commander: Theirs, address: str
) -> None:
    bridge.start(mode="their-commander", address=address)
    sends(bridge, commander, WALKS, until=lambda: bridge.written[WALK_KEY])
    bridge.until(lambda: bridge.told("sonic-silent"))
    bridge.process.send_signal(signal.SIGSTOP)
    count = len(bridge.written[WALK_KEY])
    for _ in range(40):
        commander.send(WALKS)
        time.sleep(0.01)
    bridge.process.send_signal(signal.SIGCONT)
    bridge.until(lambda: bridge.detail["topics"]["planner"]["dropped"].get("stale", 0) > 0)
    assert len(bridge.written[WALK_KEY]) == count
    sends(bridge, commander, WALKS, until=lambda: len(bridge.written[WALK_KEY]) > count)


def test_a_bridge_that_was_killed_and_is_started_again_goes_on(
    bridge: BridgeStation, commander: Theirs, address: str
) -> None:
    bridge.start(mode="their-commander", address=address)
    sends(bridge, commander, WALKS, until=lambda: bridge.written[WALK_KEY])
    bridge.process.kill()
    bridge.process.wait()
    count = len(bridge.written[WALK_KEY])
    bridge.start(mode="their-commander", address=address)
    sends(bridge, commander, WALKS, until=lambda: len(bridge.written[WALK_KEY]) > count)


def test_a_commander_that_is_started_again_is_heard_again_with_a_told_gap(
    bridge: BridgeStation, commander: Theirs, address: str
) -> None:
    bridge.start(mode="their-commander", address=address)
    sends(bridge, commander, WALKS, until=lambda: bridge.written[WALK_KEY])
    commander.close()
    bridge.until(lambda: bridge.told("sonic-silent"))
    with contextlib.closing(Theirs(zmq.PUB, address)) as again:
        sends(bridge, again, WALKS, until=lambda: bridge.told("sonic-back"))
    assert bridge.told("sonic-back")[0].detail["silent_s"] > 0.5


def test_streamed_poses_are_whole_body_commands(bridge: BridgeStation, commander: Theirs, address: str) -> None:
    bridge.start(mode="their-commander", stream="pose", address=address)
    streamed, asked = StreamedPose(), FORMAT.default.copy()
    asked[-1] = 0.3

    def passed() -> bool:
        commander.send(streamed.pack(asked, 0.02))
        return len(bridge.written[FORMAT.key]) > 20

    bridge.until(passed)
    assert bridge.vectors(FORMAT.key)[-1][6:] == pytest.approx(asked[6:], abs=1e-6)
    sends(bridge, commander, pack("pose", 4, {"token_state": np.zeros(64, np.float32)}),
          until=lambda: bridge.told("sonic-refused"))  # fmt: skip
    assert "no SMPL, no tokens" in bridge.told("sonic-refused")[0].detail["reason"]


# -- Our commander, their robot --------------------------------------------------------------------------------------
@pytest.fixture
def writer(bus: Bus) -> Iterator[Writer]:
    with contextlib.closing(Writer(bus, WALK_KEY)) as made:
        yield made


def driven(bridge: BridgeStation, robot: Theirs, writer: Writer, address: str) -> None:
    bridge.start(mode="our-commander", address=address)
    writer.vector = [0.4, 0.0, 0.2]
    bridge.until(lambda: [robot.hear()] and robot.plans and robot.plans[-1].speed == pytest.approx(0.4))


def stands(robot: Theirs) -> bool:
    robot.hear()
    return bool(robot.plans) and robot.plans[-1].mode == IDLE


def test_nothing_is_sent_before_the_first_command_and_who_engages_starts_their_robot(
    bridge: BridgeStation, robot: Theirs, writer: Writer, address: str
) -> None:
    bridge.start(mode="our-commander", address=address)
    bridge.until(lambda: bridge.told("sonic-heard"))
    time.sleep(0.3)
    robot.hear()
    assert (robot.orders, robot.plans) == ([], [])
    writer.vector = [0.4, 0.0, 0.2]
    bridge.until(lambda: [robot.hear()] and len(robot.plans) > 100)
    assert set(robot.orders) == {Order(start=True, stop=False, is_planner=True)}
    assert len(robot.orders) == 10
    plan = robot.plans[-1]
    assert (plan.mode, plan.speed, plan.height) == (SLOW_WALK, pytest.approx(0.4), -1.0)
    assert plan.movement == pytest.approx(plan.facing, abs=1e-6)
    turned = [np.arctan2(each.facing[1], each.facing[0]) for each in robot.plans[-51:]]
    assert turned[-1] - turned[0] == pytest.approx(0.2, abs=0.02)
    told = bridge.detail["topics"]["planner"]
    assert (told["gate"], told["heard"]) == ("tracking", True)


def test_faster_than_is_allowed_is_not_asked_for(
    bridge: BridgeStation, robot: Theirs, writer: Writer, address: str
) -> None:
    bridge.start(mode="our-commander", address=address, fastest_m_s=0.5)
    writer.vector = [1.5, 0.0, 0.0]
    bridge.until(lambda: [robot.hear()] and len(robot.plans) > 50)
    assert max(plan.speed for plan in robot.plans) <= 0.5


def test_a_commander_of_ours_that_falls_silent_leaves_their_robot_standing(
    bridge: BridgeStation, robot: Theirs, writer: Writer, address: str
) -> None:
    driven(bridge, robot, writer, address)
    writer.vector = None
    bridge.until(lambda: stands(robot))
    sent = len(robot.plans)
    bridge.until(lambda: stands(robot) and len(robot.plans) > sent + 20)
    assert not any(order.stop for order in robot.orders), "SONIC lets the motors go at a stop"


def test_an_emergency_stop_and_a_release_after_which_the_commander_begins_anew(
    bridge: BridgeStation, robot: Theirs, writer: Writer, address: str, bus: Bus
) -> None:
    driven(bridge, robot, writer, address)
    bus.publish({keys.ESTOP: b'{"stop": true, "reason": "test"}'})
    bridge.until(lambda: stands(robot))
    assert bridge.told("estop")[0].detail["reason"] == "test"
    bus.publish({keys.ESTOP: b'{"stop": false}'})
    bridge.until(lambda: bridge.told("estop-reset"))
    sent = len(robot.plans)
    bridge.until(lambda: [robot.hear()] and len(robot.plans) > sent + 30)
    assert stands(robot), "its commander wrote through the stop"
    writer.vector = None
    time.sleep(0.5)
    writer.vector = [0.4, 0.0, 0.0]
    bridge.until(lambda: [robot.hear()] and robot.plans[-1].speed == pytest.approx(0.4))


def test_ctrl_c_leaves_their_robot_standing(bridge: BridgeStation, robot: Theirs, writer: Writer, address: str) -> None:
    driven(bridge, robot, writer, address)
    assert bridge.interrupt() == 0
    wait_until(lambda: stands(robot))
    assert [plan.mode for plan in robot.plans[-5:]] == [IDLE] * 5


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["dead", "frozen"])
def test_a_lost_bus_leaves_their_robot_standing(
    processes: None, tmp_path: Path, address: str, robot: Theirs, how: signal.Signals
) -> None:
    server = RedisServer.start(ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock"))
    try:
        with (
            contextlib.closing(BridgeStation("sonic", server.address, tmp_path)) as bridge,
            Bus(server.address, name="commander") as bus,
            contextlib.closing(Writer(bus, WALK_KEY)) as writer,
        ):
            driven(bridge, robot, writer, address)
            os.kill(server.pid, how)
            wait_until(lambda: stands(robot))
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(server.pid, signal.SIGCONT)
        server.stop()


def test_their_robot_that_comes_and_goes_is_told_of(
    bridge: BridgeStation, robot: Theirs, writer: Writer, address: str
) -> None:
    driven(bridge, robot, writer, address)
    robot.close()
    bridge.until(lambda: bridge.told("sonic-not-heard"))
    with contextlib.closing(Theirs(zmq.SUB, address)) as again:
        bridge.until(lambda: [again.hear()] and again.plans)
        bridge.until(lambda: len(bridge.told("sonic-heard")) == 2)
        assert again.orders == [], "a robot that comes back is not started by itself"


def test_motions_on_the_bus_are_streamed_poses(bridge: BridgeStation, robot: Theirs, bus: Bus, address: str) -> None:
    bridge.start(mode="our-commander", stream="pose", address=address)
    asked = FORMAT.default.copy()
    asked[-1] = 0.3
    with contextlib.closing(Writer(bus, FORMAT.key)) as writer:
        writer.vector = asked
        bridge.until(lambda: [robot.hear()] and robot.frames and robot.frames[-1][-1] == pytest.approx(0.3))
        assert set(robot.orders) == {Order(start=True, stop=False, is_planner=False)}
        assert robot.frames[-1] == pytest.approx(asked[6:], abs=1e-6)
        assert np.abs(np.diff(robot.frames, axis=0)).max() < 2.0, "no jump"
        writer.vector = None
        bridge.until(lambda: [robot.hear()] and robot.frames[-1] == pytest.approx(FORMAT.default[6:], abs=1e-6))
        bridge.until(lambda: bridge.told("sonic-at-rest"))


# -- Settings --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (
            {"mode": "their-commander", "address": "127.0.0.1:5556"},
            r"expected an address such as tcp://127\.0\.0\.1:5556",
        ),
        ({"mode": "our-commander", "address": "tcp://*:5556"}, "listens on every network; expected the one address"),
        ({"mode": "our-commander", "address": "tcp://0.0.0.0:5556"}, "listens on every network"),
        ({"mode": "their-commander", "address": "tcp://localhost:99999"}, "expected an address"),
        ({"mode": "their-commander", "robot": "G1 29"}, "expected the end of a robot's keys"),
        ({"mode": "our-commander", "fastest_m_s": 7.0}, r"fastest_m_s is 7; expected 0\.1 to 2\.5 m/s"),
        ({"mode": "our-commander", "legs": "velocity-height"}, "takes no height while it walks"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        build(SonicConfig, settings, where="test")


def test_a_port_that_is_taken_ends_it_with_what_to_do(bridge: BridgeStation, commander: Theirs, address: str) -> None:
    bridge.launch(mode="our-commander", address=address)
    code, words = bridge.ends()
    assert code == 1
    assert f"{address}: cannot be listened on: Address already in use" in words
