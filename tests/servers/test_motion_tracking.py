"""The bridge to motion_tracking: its pose server, and its robot, are played by plain ZeroMQ sockets in a thread."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import zmq

from adapters.commands.twist2 import FORMAT
from adapters.motions.load import load
from servers.motion_tracking import MotionTrackingConfig
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.config import build
from station.errors import ConfigError
from station.rotations import roll_pitch_yaw
from tests.adapters.test_pose_server import QPOS, answer
from tests.servers.bridge_station import BridgeStation, InThread, Writer, free_port
from tests.waiting import wait_until


class Peer(InThread):
    """One of theirs, with three sockets."""

    def __init__(self, kinds: tuple[int, int, int], ports: list[int], *, listens: bool) -> None:
        context = zmq.Context.instance()
        self._sockets = [context.socket(kind) for kind in kinds]
        for socket, port in zip(self._sockets, ports, strict=True):
            socket.setsockopt(zmq.LINGER, 0)
            (socket.bind if listens else socket.connect)(f"tcp://127.0.0.1:{port}")
        super().__init__()

    def close(self) -> None:
        super().close()
        for socket in self._sockets:
            socket.close()


class Server(Peer):
    """Listens on three ports and answers as motion_tracking's does: the newest question, whether any of them begins."""

    def __init__(self, ports: list[int]) -> None:
        self.qpos, self.pressed = QPOS, ""
        self.is_mute, self.delay_s = False, 0.0
        self.questions: list[dict[str, bool]] = []
        super().__init__((zmq.PULL, zmq.PUSH, zmq.PUSH), ports, listens=True)

    def _run(self) -> None:
        questions, answers, buttons = self._sockets
        told_s = 0.0
        while not self._ends.is_set():
            asked = []
            questions.poll(5)
            with contextlib.suppress(zmq.Again):
                while True:
                    asked.append(json.loads(questions.recv_string(zmq.NOBLOCK)))
            self.questions += asked
            with contextlib.suppress(zmq.Again):
                if asked and not self.is_mute:
                    time.sleep(self.delay_s)
                    head, _, numbers = answer(self.qpos, start=any(each["start"] for each in asked)).partition(b"\0")
                    answers.send_multipart([head, numbers], zmq.NOBLOCK)
                if time.monotonic() - told_s > 0.02:
                    told_s = time.monotonic()
                    pressed = {name: self.pressed == name for name in ("right_key_one", "left_key_one")}
                    told = {"t_ms": int(time.time() * 1e3), "controller_buttons": pressed}
                    buttons.send_string(json.dumps(told), zmq.NOBLOCK)


@pytest.fixture
def bridge(bus_server: BusAddress, tmp_path: Path) -> Iterator[BridgeStation]:
    with contextlib.closing(BridgeStation("motion-tracking", bus_server, tmp_path)) as made:
        yield made


@pytest.fixture
def ports() -> list[int]:
    return [free_port() for _ in range(3)]


def press(bridge: BridgeStation, server: Server, button: str, told: str) -> None:
    """Press a button until the bridge tells of it."""
    count = len(bridge.told(told))
    bridge.until(lambda: bridge.detail["buttons"] > 2)  # it has seen that none is pressed
    server.pressed = button
    bridge.until(lambda: len(bridge.told(told)) > count)
    server.pressed = ""


def test_poses_are_followed_from_one_button_to_the_other(bridge: BridgeStation, ports: list[int]) -> None:
    bridge.start(ports=ports)
    with contextlib.closing(Server(ports)) as server:
        bridge.until(lambda: bridge.detail["buttons"] > 10)
        assert (bridge.written, server.questions) == ({}, [])
        press(bridge, server, "right_key_one", "motion-tracking-begun")
        bridge.until(lambda: len(bridge.written[FORMAT.key]) > 20)
        assert bridge.vectors(FORMAT.key)[-1][6:] == pytest.approx(FORMAT.default[6:], abs=1e-6)
        assert [each["start"] for each in server.questions].count(True) >= 1
        server.qpos = QPOS + np.array([*[0.0] * 35, 0.3])
        bridge.until(lambda: bridge.vectors(FORMAT.key)[-1][-1] == pytest.approx(0.3, abs=1e-6))
        press(bridge, server, "left_key_one", "motion-tracking-ended")
        bridge.until(lambda: bridge.told("motion-tracking-silent"))
        count = len(bridge.written[FORMAT.key])
        press(bridge, server, "right_key_one", "motion-tracking-begun")
        bridge.until(lambda: len(bridge.written[FORMAT.key]) > count)
    assert bridge.interrupt() == 0


def test_bad_poses_are_refused_a_silent_server_is_told_of_and_one_that_comes_back_is_followed(
    bridge: BridgeStation, ports: list[int]
) -> None:
    bridge.start(ports=ports)
    with contextlib.closing(Server(ports)) as server:
        press(bridge, server, "right_key_one", "motion-tracking-begun")
        bridge.until(lambda: bridge.written[FORMAT.key])
        server.qpos = QPOS * np.nan
        bridge.until(lambda: bridge.told("motion-tracking-refused"))
        server.qpos = QPOS + np.array([0, 0, 9.0, *[0.0] * 33])
        bridge.until(lambda: bridge.detail["streams"]["poses"]["dropped"].get("out-of-range", 0) > 2)
        server.qpos = QPOS
        server.is_mute = True
        bridge.until(lambda: bridge.told("motion-tracking-silent"))
        server.is_mute = False
        bridge.until(lambda: bridge.told("motion-tracking-back"))
    bridge.until(lambda: len(bridge.told("motion-tracking-silent")) == 2)
    with contextlib.closing(Server(ports)):
        bridge.until(lambda: len(bridge.told("motion-tracking-back")) == 2)


def test_an_answer_from_before_the_bridge_stood_still_is_stale(bridge: BridgeStation, ports: list[int]) -> None:
    bridge.start(ports=ports)
    with contextlib.closing(Server(ports)) as server:
        press(bridge, server, "right_key_one", "motion-tracking-begun")
        bridge.until(lambda: bridge.written[FORMAT.key])
        server.delay_s = 0.01  # so that mostly a question is out

        def is_stale() -> bool:
            bridge.process.send_signal(signal.SIGSTOP)
            time.sleep(0.15)
            bridge.process.send_signal(signal.SIGCONT)
            time.sleep(0.1)
            return any("stale" in event.detail.get("reason", "") for event in bridge.told("motion-tracking-refused"))

        bridge.until(is_stale)
        passed = bridge.detail["streams"]["poses"]["passed"]
        bridge.until(lambda: bridge.detail["streams"]["poses"]["passed"] > passed)


# -- Our commander, their robot --------------------------------------------------------------------------------------
class Robot(Peer):
    """Asks as motion_tracking's deployment does, from its description and with nothing of ours.

    50 times a second it takes up the buttons that were said last: a rise of ``right_key_one`` begins anew, one of
    ``left_key_one`` ends. While it has begun a question is out, and asked anew after 0.2 s; an answer that does not
    begin counts only after one that does. It stays in the pose that came last.
    """

    def __init__(self, ports: list[int]) -> None:
        self.frames: list[np.ndarray] = []
        self.latency_s: list[float] = []
        self.starts: list[int] = []
        self.begun, self.ended, self.odd = 0, 0, 0
        self._is_on = self._is_starting = False
        self._pressed = (False, False)
        self._asked_s: float | None = None
        super().__init__((zmq.PUSH, zmq.PULL, zmq.PULL), ports, listens=False)

    @property
    def joints(self) -> np.ndarray:
        return self.frames[-1][7:]

    def say(self, *parts: bytes) -> None:
        """Send what is no question."""
        self._sockets[0].send_multipart(parts)

    def _run(self) -> None:
        questions, answers, buttons = self._sockets
        due_s = time.monotonic()
        while not self._ends.is_set():
            due_s = max(due_s + 0.02, time.monotonic() - 0.02)
            while (left_s := due_s - time.monotonic()) > 0:
                if answers.poll(int(left_s * 1e3)):
                    self._take(*answers.recv_multipart())
            said = [json.loads(each) for each in _all_of(buttons)]
            if said:
                assert abs(said[-1]["t_ms"] / 1e3 - time.time()) < 30.0
                self._look(said[-1]["controller_buttons"])
            now_s = time.monotonic()
            if self._is_on and (self._asked_s is None or now_s - self._asked_s > 0.2):
                with contextlib.suppress(zmq.Again):
                    questions.send(json.dumps({"start": self._is_starting}).encode(), zmq.NOBLOCK)
                    self._asked_s = now_s

    def _look(self, buttons: dict[str, bool]) -> None:
        begins, ends = buttons["right_key_one"], buttons["left_key_one"]
        if ends and not self._pressed[1]:
            self.ended, self._is_on, self._asked_s = self.ended + 1, False, None
        if begins and not self._pressed[0]:
            self.begun, self._is_on, self._is_starting, self._asked_s = self.begun + 1, True, True, None
        self._pressed = begins, ends

    def _take(self, head: bytes, numbers: bytes) -> None:
        said = json.loads(head)
        assert (said["num_frames"], said["qpos_size"], len(numbers)) == (1, 36, 144)
        if not self._is_on or self._asked_s is None or said["start"] != self._is_starting:
            self.odd += 1
            return
        self.latency_s.append(time.monotonic() - self._asked_s)
        if self._is_starting:
            self.starts.append(len(self.frames))
        self._is_starting, self._asked_s = False, None
        self.frames.append(np.array(struct.unpack("<36f", numbers)))


def _all_of(socket: zmq.Socket) -> Iterator[bytes]:
    with contextlib.suppress(zmq.Again):
        while True:
            yield socket.recv(zmq.NOBLOCK)


@pytest.fixture
def robot(ports: list[int]) -> Iterator[Robot]:
    with contextlib.closing(Robot(ports)) as made:
        yield made


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    with Bus(bus_server, name="commander", timeout_s=5.0) as client:
        yield client


@pytest.fixture
def writer(bus: Bus) -> Iterator[Writer]:
    with contextlib.closing(Writer(bus, FORMAT.key)) as made:
        yield made


RAISED = FORMAT.default + np.array([*[0.0] * 34, 0.3])
"""A command: the right hand is turned."""


def starts(bridge: BridgeStation, ports: list[int]) -> None:
    """Start the bridge, and wait until one robot is connected."""
    bridge.start(mode="our-commander", ports=ports)
    bridge.until(lambda: bridge.detail["streams"]["poses"]["connected"] == 1)


def driven(bridge: BridgeStation, robot: Robot, writer: Writer, ports: list[int]) -> None:
    starts(bridge, ports)
    writer.vector = RAISED
    bridge.until(lambda: robot.frames and robot.joints[-1] == pytest.approx(0.3, abs=1e-6))


def stands(robot: Robot) -> bool:
    return robot.joints == pytest.approx(FORMAT.default[6:], abs=1e-6)


def test_nothing_is_said_before_the_first_command_and_who_engages_begins(
    bridge: BridgeStation, robot: Robot, writer: Writer, ports: list[int]
) -> None:
    starts(bridge, ports)
    robot.say(b'{"start": false}')
    bridge.until(lambda: bridge.detail["streams"]["poses"]["asked"] == 1)
    assert bridge.detail["streams"]["poses"]["unanswered"] == {"before the first command": 1}
    assert (robot.begun, robot.frames, robot.odd) == (0, [], 0)
    command = FORMAT.default.copy()
    command[[0, 2, 3, 5]] = 0.3, 0.7, 0.1, 0.4
    writer.vector = command
    bridge.until(lambda: len(robot.frames) > 150)
    assert (robot.begun, robot.ended, robot.odd) == (1, 0, 0)
    frames = np.array(robot.frames)
    assert frames[-1, 7:] == pytest.approx(FORMAT.default[6:], abs=1e-6)
    assert frames[-1, 2] == pytest.approx(0.7, abs=1e-6)
    roll, pitch, _ = roll_pitch_yaw(frames[-1, 3:7])
    assert (roll, pitch) == (pytest.approx(0.1, abs=1e-6), pytest.approx(0.0, abs=1e-6))
    yaw = np.unwrap([roll_pitch_yaw(frame[3:7])[2] for frame in frames[-101:]])
    assert yaw[-1] - yaw[0] == pytest.approx(0.4 * 2.0, rel=0.15), "100 questions are two seconds"
    went = np.linalg.norm(np.diff(frames[-101:, :2], axis=0), axis=1).sum()
    assert went == pytest.approx(0.3 * 2.0, rel=0.15)
    assert np.median(robot.latency_s) < 0.01, "answered when it is asked, and not at the next tick"
    bridge.until(lambda: bridge.told("motion-tracking-asked"))
    told = bridge.detail["streams"]["poses"]
    assert (told["gate"], told["connected"], told["asked"] - told["answered"]) == ("tracking", 1, 1)
    assert 0 < told["age_ms"][0] < told["age_ms"][1]


def test_a_commander_of_ours_that_falls_silent_leaves_their_robot_standing_and_ends(
    bridge: BridgeStation, robot: Robot, writer: Writer, ports: list[int]
) -> None:
    driven(bridge, robot, writer, ports)
    writer.vector = None
    bridge.until(lambda: robot.ended)
    assert stands(robot), "it stays in the pose that came last"
    assert len({frame.tobytes() for frame in np.array(robot.frames)[-5:, 7:]}) == 1, "which was not only just there"
    assert np.abs(np.diff(np.array(robot.frames)[:, 7:], axis=0)).max() < 0.1, "no jump"
    bridge.until(lambda: bridge.told("motion-tracking-not-asked"))
    assert bridge.told("motion-tracking-not-asked")[0].severity == "info", "as it was told to"
    writer.vector = RAISED
    bridge.until(lambda: robot.begun == 2 and robot.joints[-1] == pytest.approx(0.3, abs=1e-6))


def test_an_emergency_stop_and_a_release_after_which_the_commander_begins_anew(
    bridge: BridgeStation, robot: Robot, writer: Writer, bus: Bus, ports: list[int]
) -> None:
    driven(bridge, robot, writer, ports)
    bus.publish({keys.ESTOP: b'{"stop": true, "reason": "test"}'})
    bridge.until(lambda: robot.ended)
    assert stands(robot)
    bus.publish({keys.ESTOP: b'{"stop": false}'})
    bridge.until(lambda: bridge.told("estop-reset"))
    time.sleep(0.5)
    assert robot.begun == 1, "its commander wrote through the stop"
    writer.vector = None
    time.sleep(0.5)
    writer.vector = RAISED
    bridge.until(lambda: robot.begun == 2)


def test_ctrl_c_leaves_their_robot_standing_and_ends(
    bridge: BridgeStation, robot: Robot, writer: Writer, ports: list[int]
) -> None:
    driven(bridge, robot, writer, ports)
    assert bridge.interrupt() == 0
    wait_until(lambda: robot.ended)
    assert stands(robot)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["dead", "frozen"])
def test_a_lost_bus_leaves_their_robot_standing(
    processes: None, tmp_path: Path, ports: list[int], robot: Robot, how: signal.Signals
) -> None:
    server = RedisServer.start(ServerOptions(folder=tmp_path, socket=tmp_path / "bus.sock"))
    try:
        with (
            contextlib.closing(BridgeStation("motion-tracking", server.address, tmp_path)) as bridge,
            Bus(server.address, name="commander") as bus,
            contextlib.closing(Writer(bus, FORMAT.key)) as writer,
        ):
            driven(bridge, robot, writer, ports)
            os.kill(server.pid, how)
            wait_until(lambda: robot.ended)
            assert stands(robot)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(server.pid, signal.SIGCONT)
        server.stop()


def test_a_robot_that_comes_back_is_told_of_and_begins_with_whoever_engages_next(
    bridge: BridgeStation, robot: Robot, writer: Writer, ports: list[int]
) -> None:
    driven(bridge, robot, writer, ports)
    robot.close()
    bridge.until(lambda: bridge.told("motion-tracking-not-heard"))
    with contextlib.closing(Robot(ports)) as again:
        bridge.until(lambda: len(bridge.told("motion-tracking-heard")) == 2)
        time.sleep(0.3)
        assert (again.begun, again.frames) == (0, []), "it is not begun by itself"
        writer.vector = None
        bridge.until(lambda: bridge.told("motion-tracking-at-rest"))
        writer.vector = RAISED
        bridge.until(lambda: again.frames and again.joints[-1] == pytest.approx(0.3, abs=1e-6))


def test_a_bridge_that_was_killed_and_is_started_again_moves_nobody_before_somebody_engages(
    bridge: BridgeStation, robot: Robot, writer: Writer, ports: list[int]
) -> None:
    driven(bridge, robot, writer, ports)
    bridge.process.kill()
    bridge.process.wait()
    writer.vector = None
    last = robot.frames[-1]
    starts(bridge, ports)
    bridge.until(lambda: bridge.detail["streams"]["poses"]["unanswered"].get("before the first command", 0) > 1)
    assert robot.frames[-1].tolist() == last.tolist()
    writer.vector = RAISED
    bridge.until(lambda: len(robot.starts) == 2 and bridge.detail["streams"]["poses"]["answered"] > 10)


def test_a_bridge_that_was_killed_and_comes_again_has_their_robot_blend_into_where_it_is(
    bridge: BridgeStation, robot: Robot, writer: Writer, ports: list[int]
) -> None:
    driven(bridge, robot, writer, ports)
    bridge.process.kill()
    bridge.process.wait()
    count = len(robot.frames)
    starts(bridge, ports)
    bridge.until(lambda: len(robot.frames) > count + 10)
    assert robot.starts == [0, count], "the first answer is to a question that begins"
    assert bridge.detail["streams"]["poses"]["unanswered"].get("not begun", 0) > 0


def test_with_two_robots_nobody_begins(bridge: BridgeStation, robot: Robot, writer: Writer, ports: list[int]) -> None:
    with contextlib.closing(Robot(ports)) as other:
        bridge.start(mode="our-commander", ports=ports)
        bridge.until(lambda: bridge.told("motion-tracking-several"))
        writer.vector = RAISED
        bridge.until(lambda: bridge.told("motion-tracking-not-begun"))
        assert "more than one robot" in bridge.told("motion-tracking-not-begun")[0].detail["reason"]
        assert (robot.begun, other.begun) == (0, 0)


def test_a_second_robot_that_comes_and_goes_is_told_of_and_ends_nothing(
    bridge: BridgeStation, robot: Robot, writer: Writer, ports: list[int]
) -> None:
    driven(bridge, robot, writer, ports)
    with contextlib.closing(Robot(ports)) as other:
        bridge.until(lambda: bridge.told("motion-tracking-several"))
    bridge.until(lambda: bridge.detail["streams"]["poses"]["connected"] == 1)
    count = len(robot.frames)
    bridge.until(lambda: len(robot.frames) > count + 20)
    assert (other.begun, robot.begun, robot.ended) == (0, 1, 0)


def test_whatever_is_no_question_is_counted_and_a_robot_is_answered_meanwhile(
    bridge: BridgeStation, robot: Robot, writer: Writer, ports: list[int]
) -> None:
    driven(bridge, robot, writer, ports)
    rng, good = random.Random(6), b'{"start": false}'
    with contextlib.closing(zmq.Context.instance().socket(zmq.PUSH)) as stranger:
        stranger.setsockopt(zmq.LINGER, 0)
        stranger.connect(f"tcp://127.0.0.1:{ports[0]}")
        for _ in range(3000):
            data = bytearray(good)
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            stranger.send(bytes(data[: rng.randrange(len(data) + 1)]))
        bridge.until(lambda: bridge.detail["streams"]["poses"]["unanswered"].get("no question", 0) > 2000)
    count = len(robot.frames)
    bridge.until(lambda: len(robot.frames) > count + 20)
    assert robot.joints[-1] == pytest.approx(0.3, abs=1e-6)


def test_our_two_sides_pass_a_motion_from_one_bus_to_another(
    bridge: BridgeStation, bus: Bus, ports: list[int], tmp_path: Path
) -> None:
    """A walk is written on one bus; what the other side writes on another is the same, joint by joint."""
    clip = load("builtin:walk-forward")
    (folder := tmp_path / "other").mkdir()
    server = RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock"))
    try:
        with (
            contextlib.closing(BridgeStation("motion-tracking", server.address, folder)) as side,
            contextlib.closing(Writer(bus, FORMAT.key)) as writer,
        ):
            side.start(ports=ports)
            starts(bridge, ports)
            began_s = time.monotonic()

            def plays() -> bool:
                at = clip.at(min(time.monotonic() - began_s, clip.duration_s))
                writer.vector = FORMAT.encode(at, clip.joint_names)
                return time.monotonic() - began_s > 4.0

            bridge.until(plays)
            writer.vector = None
            side.until(lambda: side.told("motion-tracking-ended"))
            bridge.until(lambda: bridge.told("motion-tracking-not-asked"))
            used = np.array([codec.parse_f64(each) for each in bridge.written[keys.command_used(FORMAT.robot)]])
            got = np.array(side.vectors(FORMAT.key))
            passed_on = np.r_[2:5, 6 : got.shape[1]]  # height [m], roll, pitch, joints [rad]
            most = np.where(passed_on < 6, 1e-5, 1e-6)  # joints alone do not tell which it was: they stand at the ends
            apart = [np.abs((used - each)[:, passed_on] / most).max(axis=1) for each in got]
            at = [each.argmin() for each in apart]
            assert max(each.min() for each in apart) < 1.0, "what is written is what was used"
            assert np.abs(used[at, 0] - got[:, 0]).mean() < 0.1, "velocity ahead [m/s], which the other side smooths"
            assert (np.diff(at)[50:150] >= 0).all(), "in their order, while it walks"
            assert np.ptp(got[:, 6:], axis=0).max() > 0.3, "it walked"
            assert got[-1, 6:] == pytest.approx(FORMAT.default[6:], abs=1e-5)
    finally:
        server.stop()


def test_a_port_that_is_taken_ends_it_with_what_to_do(bridge: BridgeStation, ports: list[int]) -> None:
    with contextlib.closing(Server(ports)):
        bridge.launch(mode="our-commander", ports=ports)
        code, words = bridge.ends()
    assert code == 1
    assert f"tcp://127.0.0.1:{ports[0]}: cannot be listened on: Address already in use" in words


# -- Settings --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"host": ""}, "host and ports is 'tcp://:28701'; expected an address"),
        ({"ports": [1, 2, 70000]}, "host and ports is 'tcp://127.0.0.1:70000'"),
        ({"mode": "our-commander", "host": "0.0.0.0"}, "listens on every network; expected the one address"),
        ({"mode": "our-commander", "host": "*"}, "listens on every network"),
        ({"robot": "G1!"}, "expected the end of a robot's keys"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        build(MotionTrackingConfig, settings, where="test")
