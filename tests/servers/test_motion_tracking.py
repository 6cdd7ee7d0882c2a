"""The bridge from motion_tracking's pose server, which is played by plain ZeroMQ sockets in a thread."""

from __future__ import annotations

import contextlib
import json
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import zmq

from adapters.commands.twist2 import FORMAT
from servers.motion_tracking import MotionTrackingConfig
from station.bus.address import BusAddress
from station.config import build
from station.errors import ConfigError
from tests.adapters.test_pose_server import QPOS, answer
from tests.servers.bridge_station import BridgeStation, free_port


class Server:
    """Listens on three ports and answers as motion_tracking's does: the newest question, whether any of them begins."""

    def __init__(self, ports: list[int]) -> None:
        context = zmq.Context.instance()
        self._sockets = [context.socket(kind) for kind in (zmq.PULL, zmq.PUSH, zmq.PUSH)]
        for socket, port in zip(self._sockets, ports, strict=True):
            socket.setsockopt(zmq.LINGER, 0)
            socket.bind(f"tcp://127.0.0.1:{port}")
        self.qpos, self.pressed = QPOS, ""
        self.is_mute, self.delay_s = False, 0.0
        self.questions: list[dict[str, bool]] = []
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        self._ends.set()
        self._thread.join()
        for socket in self._sockets:
            socket.close()

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


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"host": ""}, "host and ports is 'tcp://:28701'; expected an address"),
        ({"ports": [1, 2, 70000]}, "host and ports is 'tcp://127.0.0.1:70000'"),
        ({"robot": "G1!"}, "expected the end of a robot's keys"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        build(MotionTrackingConfig, settings, where="test")
