"""The LCM bridge: what it passes on, what it refuses, and what becomes of a robot whose commander falls silent."""

from __future__ import annotations

import contextlib
import math
import os
import random
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from adapters.lcm import types
from adapters.lcm.homie import STATE_CHANNEL, command_of, routes
from adapters.lcm.multicast import GROUP, PORT
from adapters.lcm.packet import datagrams
from servers.lcm import ChannelIntake, LcmConfig
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.config import build
from station.control.foreign_stream import LATE_S, SILENT_S, Arrived
from station.errors import ConfigError
from tests.adapters.lcm.library import expect_library
from tests.adapters.lcm.loopback import multicast_loopback
from tests.adapters.lcm.test_multicast import damaged
from tests.network_link.link import Link
from tests.servers.lcm_station import SOME_ARMS, LcmStation, lcm_station, message
from tests.tiers import ROOT
from tests.waiting import wait_until

LEGS = keys.action("velocity-height_g1_29_legs")
LEFT, RIGHT = (keys.action_joints(f"g1_29_{side}_arm") for side in ("left", "right"))
A, B = "127.0.0.1:1001", "127.0.0.1:1002"
WALK = [0.5, 0.1, 0.2, 0.6]


@pytest.fixture
def bridge(bus_server: BusAddress, tmp_path: Path) -> Iterator[LcmStation]:
    with lcm_station(bus_server, tmp_path) as made:
        yield made


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="commander", timeout_s=5.0) as client:
        yield client


# -- What a channel takes, without a process -------------------------------------------------------------------------
def intake(channel: str = "arm_action", *, hands: bool = True) -> ChannelIntake:
    found = routes(command_of("g1_dex3", "velocity-height", hands=hands))
    return ChannelIntake(next(route for route in found if route.channel.name == channel))


def came(data: bytes, at_s: float, sender: str = A) -> Arrived:
    return Arrived(data, sender, at_s)


def names(of: ChannelIntake, now_s: float) -> list[str]:
    return [name for name, _, _ in of.on_tick(now_s)]


GOOD = message("arm_action", SOME_ARMS)
BAD = {
    "wrong-length": GOOD[:-8],
    "wrong-type": b"\0" + GOOD[1:],
    "not-finite": message("arm_action", [math.nan, *SOME_ARMS[1:]]),
    "out-of-range": message("arm_action", [*SOME_ARMS[:-1], 3.0]),
}


@pytest.mark.parametrize("kind", BAD)
def test_what_is_no_command_is_refused_counted_and_told_once(kind: str) -> None:
    arms = intake()
    for number in range(3):
        assert arms.take(came(BAD[kind], number * 0.02), number * 0.02) is None
    assert arms.dropped == {kind: 3}
    assert names(arms, 0.1) == ["lcm-refused"]
    assert arms.take(came(GOOD, 0.1), 0.1) is not None
    assert names(arms, 0.2) == []
    ((name, _, detail),) = arms.on_tick(0.05 + SILENT_S)
    assert (name, detail) == ("lcm-refused", {"channel": "arm_action", "ended": True, "dropped": {kind: 3}})


def test_who_sends_nothing_good_keeps_no_cockpit_out() -> None:
    arms = intake()
    assert arms.take(came(BAD["wrong-type"], 0.0, B), 0.0) is None
    assert arms.take(came(GOOD, 0.01, A), 0.01) is not None


def test_an_infinite_height_is_refused_also_where_legs_take_none() -> None:
    (pedals, *_) = routes(command_of("g1_29", "velocity", hands=False))
    assert ChannelIntake(pedals).take(came(message("pedal_command", [0, 0, 0, math.inf]), 0.0), 0.0) is None


def test_a_packet_of_the_pedals_on_the_channel_of_arms_is_refused_and_one_of_hands_is_told_by_its_range() -> None:
    arms, walk = intake(), message("pedal_command", WALK)
    assert arms.take(came(walk, 0.0), 0.0) is None
    assert arms.dropped == {"wrong-length": 1}
    closed = message(
        "hand_action", [0, 1.05, 1.75, -1.57, -1.75, -1.57, -1.75, 0, -1.05, -1.75, 1.57, 1.75, 1.57, 1.75]
    )
    assert intake("hand_action").take(came(closed, 0.0), 0.0) is not None, "OpenHomie's own start pose"
    assert arms.take(came(closed, 0.1), 0.1) is None, "an arm's wrist does not reach where a closed finger is"
    assert arms.dropped["out-of-range"] == 1


def test_what_lay_in_the_kernel_while_the_process_stood_still_is_refused() -> None:
    arms = intake()
    assert arms.take(came(GOOD, 0.0), LATE_S + 0.01) is None
    assert arms.dropped == {"stale": 1}
    assert arms.take(came(GOOD, 0.2), 0.19 + LATE_S) is not None


def test_a_second_cockpit_is_heard_only_once_the_first_has_fallen_silent() -> None:
    arms = intake()
    for number in range(20):
        now_s = number * 0.02
        assert arms.take(came(GOOD, now_s, A), now_s) is not None
        assert arms.take(came(GOOD, now_s + 0.01, B), now_s + 0.01) is None
    assert arms.dropped == {"second-sender": 20}
    assert "lcm-second-sender" in names(arms, 0.4)
    silent_s = 0.38 + SILENT_S
    assert arms.take(came(GOOD, silent_s - 0.01, B), silent_s - 0.01) is None
    assert arms.take(came(GOOD, silent_s + 0.01, B), silent_s + 0.01) is not None
    assert "lcm-handover" in names(arms, silent_s + 0.01)


def test_live_silent_and_back_are_told_and_the_heartbeat_says_how_old_what_was_passed_on_is() -> None:
    arms = intake()
    taken = arms.take(came(GOOD, 1.0), 1.002)
    assert taken is not None
    arms.record(taken, 1.003)
    assert names(arms, 1.01) == ["lcm-live"]
    assert arms.status(1.1) == {
        "passed": 1, "dropped": {}, "live": True, "sender": "127.0.0.1:1001", "age_s": 0.1, "delay_ms": 3.0,
    }  # fmt: skip
    assert names(arms, 1.0 + SILENT_S) == []
    assert names(arms, 1.01 + SILENT_S) == ["lcm-silent"]
    again = arms.take(came(GOOD, 5.0), 5.0)
    assert again is not None
    arms.record(again, 5.0)
    assert names(arms, 5.0) == ["lcm-back"]


# -- Their cockpit, our robot ----------------------------------------------------------------------------------------
def test_messages_of_a_cockpit_are_commands_on_the_bus_and_nothing_is_written_once_it_is_silent(
    bridge: LcmStation,
) -> None:
    bridge.start(mode="their-cockpit")

    def passed() -> bool:
        bridge.send("pedal_command", WALK)
        bridge.send("arm_action", SOME_ARMS)
        bridge.send("hand_action", [0.0] * 14)
        return len(bridge.written[LEGS]) > 20 and len(bridge.written[LEFT]) > 20

    bridge.until(passed)
    sources = {keys.command_source(f"g1_29_{part}") for part in ("legs", "left_arm", "right_arm")}
    assert set(bridge.written) == {LEGS, LEFT, RIGHT, *sources}, "a robot without hands has no command of hands"
    assert bridge.vectors(LEGS)[-1] == WALK
    assert bridge.vectors(LEFT)[-1] + bridge.vectors(RIGHT)[-1] == SOME_ARMS
    bridge.until(lambda: {event.detail["channel"] for event in bridge.told("lcm-silent")} == {
        "pedal_command", "arm_action",
    })  # fmt: skip
    count = {key: len(values) for key, values in bridge.written.items()}
    bridge.until(lambda: bridge.detail["channels"]["arm_action"]["live"] is False)
    assert {key: len(values) for key, values in bridge.written.items()} == count
    assert bridge.detail["channels"]["arm_action"]["passed"] == count[LEFT]
    assert bridge.detail["not_for_us"]["another channel"] >= 20
    bridge.send("pedal_command", WALK)
    bridge.until(lambda: bridge.told("lcm-back"))
    assert bridge.interrupt() == 0
    (ends,) = bridge.told("teleop-commands-end")
    assert ends.detail["channels"] == ["pedal_command"]


def test_hands_are_passed_on_to_a_robot_that_has_some(bridge: LcmStation) -> None:
    bridge.start(mode="their-cockpit", robot="g1_dex3", hands=True)
    hands = [index / 100 for index in range(7)] + [-index / 100 for index in range(7)]
    keys_of_hands = [keys.action_joints(f"g1_dex3_{side}_hand") for side in ("left", "right")]

    def passed() -> bool:
        bridge.send("hand_action", hands)
        return all(bridge.written[key] for key in keys_of_hands)

    bridge.until(passed)
    assert bridge.vectors(keys_of_hands[0])[0] + bridge.vectors(keys_of_hands[1])[0] == hands


def test_ten_thousand_damaged_datagrams_reach_no_key_and_end_nothing(bridge: LcmStation) -> None:
    bridge.start(mode="their-cockpit")
    rng, good = random.Random(5), datagrams(1, "pedal_command", message("pedal_command", WALK))[0]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as anybody:
        anybody.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        for number in range(10_000):
            anybody.sendto(damaged(rng, good), (GROUP, bridge.port))
            if number % 500 == 0:
                bridge.until(lambda: True)
    wanted = sum(bridge.detail["not_for_us"].values())
    bridge.until(lambda: sum(bridge.detail["not_for_us"].values()) > wanted)
    assert bridge.written == {}
    bridge.until(lambda: [bridge.send("pedal_command", WALK)] and bridge.written[LEGS])
    assert bridge.vectors(LEGS)[0] == WALK


def test_the_cockpit_of_the_page_drives_through_the_bridge_by_lcms_own_library(bridge: LcmStation) -> None:
    expect_library()
    page = (ROOT / "docs" / "lcm.md").read_text(encoding="utf-8")
    (cockpit,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    with multicast_loopback() as inside:
        bridge.start(mode="their-cockpit", inside=inside, port=PORT)
        with subprocess.Popen([*inside, sys.executable, "-c", cockpit], cwd=ROOT) as theirs:
            bridge.until(lambda: len(bridge.written[LEGS]) > 50)
            theirs.kill()
        assert bridge.vectors(LEGS)[-1] == [0.4, 0.0, 0.0, 0.74]
        bridge.until(lambda: bridge.told("lcm-silent"))


COCKPIT = """
import sys, time
from adapters.lcm.multicast import Multicast
to = Multicast(interface=sys.argv[1])
while True:
    to.send("pedal_command", bytes.fromhex(sys.argv[2]))
    time.sleep(0.02)
"""


@pytest.mark.usefixtures("network_links")
def test_a_cockpit_at_the_other_end_of_a_cable_is_heard_until_it_is_pulled_and_a_stranger_never(
    bridge: LcmStation,
) -> None:
    theirs, ours, told = "192.168.123.164", "192.168.123.222", message("pedal_command", WALK).hex()
    with Link((theirs, ours), seed=1) as link:
        cockpit, here = link.ends
        bridge.start(mode="their-cockpit", inside=here.prefix, interface=ours, peer=theirs, port=PORT)
        stranger = here.popen([sys.executable, "-c", COCKPIT, ours, told], cwd=ROOT)
        bridge.until(lambda: bridge.detail["not_for_us"].get("another computer", 0) > 20)
        assert bridge.written == {}
        with cockpit.popen([sys.executable, "-c", COCKPIT, theirs, told], cwd=ROOT) as sending:
            bridge.until(lambda: len(bridge.written[LEGS]) > 50)
            link.pull()
            bridge.until(lambda: bridge.told("lcm-silent"))
            link.plug()
            bridge.until(lambda: bridge.told("lcm-back"))
            sending.kill()
        stranger.kill()
        stranger.wait()
    assert bridge.vectors(LEGS)[-1] == WALK


# -- Our cockpit, their robot ----------------------------------------------------------------------------------------
class TheirRobot:
    """Does what came last for ever, as HOMIE's `g1_control` does; keeps all of it."""

    def __init__(self, bridge: LcmStation) -> None:
        self.bridge = bridge
        self.heard: dict[str, list[list[float]]] = {"pedal_command": [], "arm_action": [], "hand_action": []}

    def hear(self) -> None:
        fields = {"pedal_command": (types.COMMAND, "command"), "arm_action": (types.ARM_ACTION, "act"),
                  "hand_action": (types.HAND_ACTION, "act")}  # fmt: skip
        for each in self.bridge.peer.receive(0.0):
            if each.channel in fields and each.sender != self.bridge.peer.address:
                kind, field = fields[each.channel]
                self.heard[each.channel].append(list(kind.decode(each.message)[field]))

    def newest(self, channel: str) -> list[float]:
        self.hear()
        return self.heard[channel][-1] if self.heard[channel] else []


class Commander:
    """Writes commands 50 times a second in a thread of its own, as a teleoperation server does."""

    def __init__(self, bus: Bus) -> None:
        self._bus, self._values = bus, dict[str, bytes]()
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def command(self, **vectors: list[float]) -> None:
        """Command parts from now on; without any nothing is written."""
        by_name = {"legs": LEGS, "left": LEFT, "right": RIGHT}
        self._values = {by_name[name]: codec.json_vector(vector) for name, vector in vectors.items()}

    def close(self) -> None:
        self._ends.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._ends.wait(0.02):
            if self._values:
                self._bus.publish(self._values)


@pytest.fixture
def robot(bridge: LcmStation) -> TheirRobot:
    return TheirRobot(bridge)


@pytest.fixture
def commander(bus: Bus) -> Iterator[Commander]:
    made = Commander(bus)
    yield made
    made.close()


REST_LEGS, REST_ARMS = [0.0, 0.0, 0.0, 0.74], [0.0] * 14


def driven(bridge: LcmStation, robot: TheirRobot, commander: Commander) -> None:
    """Start the bridge and drive their robot by all its parts."""
    bridge.start(mode="our-cockpit")
    commander.command(legs=WALK, left=SOME_ARMS[:7], right=SOME_ARMS[7:])
    bridge.until(
        lambda: (
            np.allclose(robot.newest("pedal_command") or 9.0, WALK)
            and np.allclose(robot.newest("arm_action") or 9.0, SOME_ARMS)
        )
    )


def largest_steps(rows: list[list[float]]) -> np.ndarray:
    return np.abs(np.diff(np.array(rows), axis=0)).max(axis=0)


def until_at_rest(bridge: LcmStation, robot: TheirRobot) -> None:
    bridge.until(lambda: robot.newest("pedal_command") == REST_LEGS and robot.newest("arm_action") == REST_ARMS)


def expect_ramps(robot: TheirRobot) -> None:
    """Expect that nothing jumped: rates of the formats, a tick that was late, and velocities that fade in 0.2 s."""
    height = largest_steps(robot.heard["pedal_command"])[3]
    arms = largest_steps(robot.heard["arm_action"]).max()
    assert height <= 0.5 * 0.04 + 1e-9
    assert arms <= 2.0 * 0.04 + 1e-9


def test_nothing_is_sent_before_the_first_command_then_fifty_times_a_second_without_a_jump(
    bridge: LcmStation, robot: TheirRobot, commander: Commander
) -> None:
    bridge.start(mode="our-cockpit")
    robot.hear()
    bridge.until(lambda: bridge.detail["channels"]["pedal_command"]["sent"] == 0)
    assert robot.heard == {"pedal_command": [], "arm_action": [], "hand_action": []}
    commander.command(legs=WALK)
    bridge.until(lambda: len(robot.newest("pedal_command") and robot.heard["pedal_command"]) > 50)
    assert robot.newest("pedal_command") == pytest.approx(WALK)
    assert robot.heard["arm_action"] == [], "nobody commands arms"
    assert largest_steps(robot.heard["pedal_command"])[3] <= 0.5 * 0.04 + 1e-9
    told = bridge.detail["channels"]["pedal_command"]
    assert told["parts"]["legs"]["gate"] == "tracking"


def test_a_commander_who_falls_silent_leaves_their_robot_at_rest(
    bridge: LcmStation, robot: TheirRobot, commander: Commander
) -> None:
    driven(bridge, robot, commander)
    commander.command()
    until_at_rest(bridge, robot)
    expect_ramps(robot)
    bridge.until(lambda: bridge.told("lcm-returning") and bridge.told("lcm-at-rest"))
    assert "old" in str(bridge.told("lcm-returning")[0].detail["parts"])
    sent = len(robot.heard["arm_action"])
    bridge.until(lambda: robot.newest("arm_action") == REST_ARMS and len(robot.heard["arm_action"]) > sent + 20)
    commander.command(legs=WALK)
    bridge.until(lambda: np.allclose(robot.newest("pedal_command"), WALK))


def test_one_part_that_falls_silent_is_brought_to_rest_while_the_others_go_on(
    bridge: LcmStation, robot: TheirRobot, commander: Commander
) -> None:
    driven(bridge, robot, commander)
    commander.command(left=SOME_ARMS[:7], right=SOME_ARMS[7:])
    bridge.until(lambda: robot.newest("pedal_command") == REST_LEGS)
    assert robot.newest("arm_action") == pytest.approx(SOME_ARMS)


def test_an_emergency_stop_brings_their_robot_to_rest_and_a_commander_has_to_begin_anew(
    bridge: LcmStation, robot: TheirRobot, commander: Commander, bus: Bus
) -> None:
    driven(bridge, robot, commander)
    bus.publish({keys.ESTOP: b'{"stop": true, "reason": "test"}'})
    until_at_rest(bridge, robot)
    expect_ramps(robot)
    assert bridge.told("estop")[0].detail["reason"] == "test"
    bus.publish({keys.ESTOP: b'{"stop": false}'})
    bridge.until(lambda: bridge.told("estop-reset"))
    count = len(robot.heard["pedal_command"])
    bridge.until(lambda: robot.newest("pedal_command") and len(robot.heard["pedal_command"]) > count + 30)
    assert robot.newest("pedal_command") == REST_LEGS, "its commander wrote through the stop"
    commander.command()
    time.sleep(0.5)
    commander.command(legs=WALK)
    bridge.until(lambda: np.allclose(robot.newest("pedal_command"), WALK))


def test_ctrl_c_brings_their_robot_to_rest_before_the_bridge_ends(
    bridge: LcmStation, robot: TheirRobot, commander: Commander
) -> None:
    driven(bridge, robot, commander)
    assert bridge.interrupt() == 0
    assert robot.newest("pedal_command") == REST_LEGS
    assert robot.newest("arm_action") == REST_ARMS
    assert robot.heard["arm_action"][-5:] == [REST_ARMS] * 5, "a datagram may be lost"
    expect_ramps(robot)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["dead", "frozen"])
def test_a_lost_bus_brings_their_robot_to_rest(processes: None, tmp_path: Path, how: signal.Signals) -> None:
    server = RedisServer.start(ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock"))
    try:
        with lcm_station(server.address, tmp_path) as bridge, Bus(server.address, name="commander") as bus:
            robot, commander = TheirRobot(bridge), Commander(bus)
            try:
                driven(bridge, robot, commander)
                os.kill(server.pid, how)
                wait_until(lambda: robot.newest("pedal_command") == REST_LEGS)
                wait_until(lambda: robot.newest("arm_action") == REST_ARMS)
                expect_ramps(robot)
            finally:
                commander.close()
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(server.pid, signal.SIGCONT)
        server.stop()


def test_arms_begin_where_their_robot_has_them(bridge: LcmStation, robot: TheirRobot, commander: Commander) -> None:
    bridge.start(mode="our-cockpit")
    stands = [0.0] * 15 + [0.4] * 7 + [-0.4] * 7
    state = types.BODY_CONTROL.encode({"q": stands, "qd": [0.0] * 29, "timestamp_us": 0})

    def begun() -> bool:
        bridge.peer.send(STATE_CHANNEL, state)
        robot.hear()
        if bridge.detail["robot_heard"]:
            commander.command(left=SOME_ARMS[:7])
        return bool(robot.heard["arm_action"])

    bridge.until(begun)
    assert robot.heard["arm_action"][0] == pytest.approx(stands[15:], abs=2.0 * 0.04)


def test_an_arm_that_nobody_commands_stays_where_their_robot_has_it(
    bridge: LcmStation, robot: TheirRobot, commander: Commander
) -> None:
    bridge.start(mode="our-cockpit")
    state = types.BODY_CONTROL.encode({"q": [0.0] * 22 + [-0.4] * 7, "qd": [0.0] * 29, "timestamp_us": 0})
    bridge.until(lambda: [bridge.peer.send(STATE_CHANNEL, state)] and bridge.detail["robot_heard"])

    def begun() -> bool:
        bridge.peer.send(STATE_CHANNEL, state)
        commander.command(left=SOME_ARMS[:7])
        return len(robot.newest("arm_action") and robot.heard["arm_action"]) > 100

    bridge.until(begun)
    commander.command()
    bridge.until(lambda: robot.newest("arm_action")[:7] == REST_ARMS[:7])
    assert np.allclose([row[7:] for row in robot.heard["arm_action"]], -0.4)


def test_hands_begin_where_hand_control_has_them_and_stay_when_nobody_commands_them(
    bridge: LcmStation, robot: TheirRobot, bus: Bus
) -> None:
    bridge.start(mode="our-cockpit", hands=True)
    key = keys.action_joints("g1_29_left_hand")
    half = [0.0, 0.5, 0.8, -0.7, -0.8, -0.7, -0.8]

    def is_there() -> bool:
        bus.publish({key: codec.json_vector(half)})
        return bool(np.allclose(robot.newest("hand_action")[:7] or 9.0, half))

    bridge.until(is_there)
    first = robot.heard["hand_action"][0]
    assert first[1] == pytest.approx(1.0472, abs=12.0 * 0.04)
    assert first[9] == pytest.approx(-1.74533, abs=0.01), (
        "the right hand, which nobody commands, is as closed as it was"
    )
    bridge.until(lambda: bridge.detail["channels"]["hand_action"]["parts"]["left_hand"]["gate"] == "waiting")
    assert robot.newest("hand_action")[:7] == pytest.approx(half)


def test_somebody_else_who_commands_their_robot_is_told(bridge: LcmStation) -> None:
    bridge.start(mode="our-cockpit")
    bridge.until(lambda: [bridge.send("pedal_command", WALK)] and bridge.told("lcm-second-sender"))
    bridge.until(lambda: any(event.detail.get("ended") for event in bridge.told("lcm-second-sender")))


HEARS = """
import sys
from adapters.lcm.multicast import Multicast
heard, by = 0, Multicast(interface=sys.argv[1])
while heard < 50:
    heard += sum(each.channel == "pedal_command" for each in by.receive(0.1))
"""


@pytest.mark.usefixtures("network_links")
def test_a_robot_at_the_other_end_of_a_cable_hears_our_commands(bridge: LcmStation, commander: Commander) -> None:
    theirs, ours = "192.168.123.164", "192.168.123.222"
    with Link((theirs, ours), seed=1) as link:
        robot, here = link.ends
        bridge.start(mode="our-cockpit", inside=here.prefix, interface=ours, peer=theirs, port=PORT)
        with robot.popen([sys.executable, "-c", HEARS, theirs], cwd=ROOT) as hearing:
            commander.command(legs=WALK)
            bridge.until(lambda: hearing.poll() is not None)
            assert hearing.returncode == 0


# -- Settings --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({}, "mode"),
        ({"mode": "cockpit"}, "mode"),
        ({"robot": "G1 29"}, "robot is 'G1 29'; expected the end of a robot's keys, such as g1_29"),
        ({"legs": "velocity-posture"}, "legs"),
        ({"interface": "eth0"}, "interface is 'eth0'; expected an IPv4 address such as 192.168.123.222"),
        ({"interface": "0.0.0.0"}, "interface is 0.0.0.0; expected the one address that this computer has"),
        ({"peer": "192.168.123.164"}, "peer is 192.168.123.164, interface is 127.0.0.1: neither reaches the other"),
        ({"group": "10.0.0.1"}, "group is 10.0.0.1; expected a multicast group such as 239.255.76.67"),
        ({"port": 0}, "port is 0; expected 1 to 65535"),
    ],
)
def test_bad_settings_are_one_line(values: dict[str, object], told: str) -> None:
    complete = {"mode": "their-cockpit", **values} if values else {}
    with pytest.raises(ConfigError) as caught:
        build(LcmConfig, complete, where="server lcm")
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)
