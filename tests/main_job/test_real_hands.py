"""Hands and neck of a robot's twin through the whole station: each a server of its own, driven by TWIST2's own keys."""

from __future__ import annotations

import json
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import redis

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from adapters.commands.hands import TWIST2_LEFT, TWIST2_NECK, TWIST2_RIGHT
from adapters.robots.g1 import twist_keys
from adapters.robots.g1.twin.neck import TwinNeck
from station import Station
from station.errors import Refused
from tests.cli.running import Home, new_home
from tests.dds_domains import domain
from tests.waiting import wait_until

pytestmark = pytest.mark.timeout(300)

PARTS = ("left_hand", "right_hand", "neck")
CLOSED = {TWIST2_LEFT.key: TWIST2_LEFT.closed.tolist(), TWIST2_RIGHT.key: TWIST2_RIGHT.closed.tolist()}
OPEN = {TWIST2_LEFT.key: [0.0] * 7, TWIST2_RIGHT.key: [0.0] * 7}


class Teleop(threading.Thread):
    """Another lab's program: it sets the keys fifty times a second, and knows of no station."""

    def __init__(self, socket: str) -> None:
        super().__init__()
        self._bus, self._is_over = redis.Redis(unix_socket_path=socket), threading.Event()
        self.wanted: dict[str, list[float]] = OPEN | {TWIST2_NECK.key: [0.0, 0.0]}

    def run(self) -> None:
        while not self._is_over.wait(0.02):
            self._bus.mset({key: json.dumps(value) for key, value in self.wanted.items()})

    def close(self) -> None:
        self._is_over.set()
        self.join()
        self._bus.close()


class Lab:
    """A bus, a twin with hands and a neck, and their servers."""

    def __init__(self, home: Home, number: int, stack: ExitStack) -> None:
        self.home, self.domain, self._stack = home, number, stack
        stack.enter_context(home.running("bus", "start"))
        wait_until(home.bus_is_there)
        folder = Path(home.environment["XDG_RUNTIME_DIR"]) / "serial"
        self.neck = TwinNeck(folder)  # here, where nothing that is in a hurry keeps its servos from answering
        stack.callback(self.neck.close)
        sets = (f"options.domain={number}", "options.hands=dex3")
        stack.enter_context(home.running("robot-twin", "g1", *(word for each in sets for word in ("--set", each))))
        wait_until(lambda: "robot-twin" in home.health())
        self.start("left_hand", "dex3-left-dds", f"domain={number}")
        self.start("right_hand", "dex3-right-dds", f"domain={number}")
        self.start("neck", "neck-dynamixel", f"port={self.neck.port.path}")
        for name in PARTS:
            self.wait_until_ready(name)

    def start(self, name: str, robot: str, option: str) -> None:
        """Start the server of a part."""
        options = (option, "first_state_within_s=50")  # as long as a busy machine may take
        sets = (f"robot={robot}", *(f"robot_options.{each}" for each in options))
        words = ("--name", name, *(word for each in sets for word in ("--set", each)))
        self._stack.enter_context(self.home.running("serve", "robot", *words))

    def wait_until_ready(self, name: str) -> None:
        """Wait until nothing is against arming a part."""
        try:
            wait_until(lambda: self.part(name).get("why_not_arm") == "")
        except AssertionError:
            raise AssertionError(f"{name}: {self.part(name)}; twin: {self.twin()}") from None

    def part(self, name: str) -> dict[str, Any]:
        health = self.home.health().get(name)
        is_there = health is not None and health.state == "active" and health.is_alive
        return health.detail if health is not None and is_there else {}

    def twin(self) -> dict[str, Any]:
        return self.home.health()["robot-twin"].detail

    def measured(self, side: str) -> list[float]:
        with redis.Redis(unix_socket_path=self.home.bus.socket) as bus:
            found: list[float] = json.loads(bus.get(twist_keys.state_hand(side)) or b"[]")
            return found

    def arm(self) -> None:
        """Arm all that there is."""
        with Station(self.home.bus.url) as station:
            wait_until(lambda: self._are_armed(station))

    def until(self, condition: Callable[[], bool]) -> None:
        """Wait, and arm again what a busy machine has made silent."""

        def holds() -> bool:
            if any(self.part(name).get("arming") == "disarmed" for name in PARTS):
                self.arm()
            return condition()

        wait_until(holds)

    def _are_armed(self, station: Station) -> bool:
        try:
            station.arm()
        except Refused:  # by a moment in which a part was not heard
            return False
        return True


def is_near(a: list[float], b: list[float]) -> bool:
    return len(a) == len(b) and max(abs(x - y) for x, y in zip(a, b, strict=True)) < 0.1


@pytest.fixture(scope="module")
def lab(processes: None) -> Iterator[tuple[Lab, Teleop]]:
    with new_home() as home, domain() as number, ExitStack() as stack:
        found = Lab(home, number, stack)
        teleop = Teleop(home.bus.socket)
        teleop.start()
        stack.callback(teleop.close)
        yield found, teleop


def test_hands_and_a_neck_follow_another_labs_program_and_tell_it_where_they_are(lab: tuple[Lab, Teleop]) -> None:
    found, teleop = lab
    assert found.twin()["left_hand"]["is_stiff"] is False
    found.arm()
    teleop.wanted = CLOSED | {TWIST2_NECK.key: [0.6, -0.4]}
    found.until(lambda: is_near(found.measured("left"), CLOSED[TWIST2_LEFT.key]))
    found.until(lambda: is_near(found.measured("right"), CLOSED[TWIST2_RIGHT.key]))
    found.until(lambda: is_near([servo.ticks / 1000 for servo in found.neck.servos], [2.439, 1.787]))
    teleop.wanted = OPEN | {TWIST2_NECK.key: [0.0, 0.0]}
    found.until(lambda: is_near(found.measured("left"), OPEN[TWIST2_LEFT.key]))


def test_one_hand_is_given_up_and_the_other_goes_on(lab: tuple[Lab, Teleop]) -> None:
    found, teleop = lab
    found.arm()
    assert found.home.run("robot-twin", "g1", "hand_silent=[right]").returncode == 0
    wait_until(lambda: found.part("right_hand").get("arming") == "disarmed")
    assert "no state of the hand for" in found.part("right_hand")["why_not_arm"]
    teleop.wanted = CLOSED
    wait_until(lambda: is_near(found.measured("left"), CLOSED[TWIST2_LEFT.key]))
    assert found.home.run("robot-twin", "g1", "--well").returncode == 0
    found.wait_until_ready("right_hand")
    assert found.twin()["right_hand"]["is_stiff"] is False


def test_a_hand_whose_server_is_killed_lets_go_by_itself_and_a_new_server_moves_nothing(
    lab: tuple[Lab, Teleop],
) -> None:
    found, teleop = lab
    found.arm()
    wait_until(lambda: found.twin()["left_hand"]["is_stiff"])
    os.kill(found.home.pids()["left_hand"], signal.SIGKILL)
    wait_until(lambda: not found.twin()["left_hand"]["is_stiff"])
    teleop.wanted = OPEN
    before = found.twin()["left_hand"]["accepted"]
    found.start("left_hand", "dex3-left-dds", f"domain={found.domain}")
    found.wait_until_ready("left_hand")
    assert found.twin()["left_hand"]["accepted"] == before
    assert not found.twin()["left_hand"]["is_stiff"]
