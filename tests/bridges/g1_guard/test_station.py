"""The whole station over the guard: it arms through it, and when its server is killed or frozen the twin is damped."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from station import Station
from station.errors import Refused
from tests.cli.running import Home, new_home
from tests.dds_domains import domain
from tests.waiting import wait_until

pytestmark = pytest.mark.timeout(300)

ROBOT = "unitree_g1_with_hands"


class Lab:
    """A bus, a twin and a guard, and a server of the robot that can be killed and started again."""

    def __init__(self, home: Home, number: int, guard: Path, stack: ExitStack) -> None:
        self.home, self._number = home, number
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self._port = probe.getsockname()[1]
        stack.enter_context(home.running("bus", "start"))
        wait_until(home.bus_is_there)
        stack.enter_context(home.running("robot-twin", "g1", "--set", f"options.domain={number}"))
        wait_until(lambda: "robot-twin" in home.health())
        self._guard = guard
        self.guard = self.start_guard()
        self._stack = stack

    def start_guard(self) -> subprocess.Popen[bytes]:
        words = ["--interface", "lo", "--domain", str(self._number), "--port", str(self._port)]
        return subprocess.Popen([str(self._guard), *words], stderr=subprocess.DEVNULL)

    def start_robot(self) -> None:
        options = {"domain": self._number, "guard": "127.0.0.1", "guard_port": self._port}
        sets = [
            "robot=g1-dds",
            "policy=default-pose",
            *(f"robot_options.{key}={value}" for key, value in options.items()),
        ]
        words = [word for each in sets for word in ("--set", each)]
        self.server = self._stack.enter_context(self.home.running("serve", "robot", *words))
        wait_until(lambda: self.robot()["why_not_arm"] is not None)

    def wait_until_ready(self) -> None:
        """Wait until nothing is against arming."""
        try:
            wait_until(lambda: self.robot()["why_not_arm"] == "", 30.0)
        except AssertionError:
            raise AssertionError(f"robot: {self.robot()}; twin: {self.twin()}") from None

    def robot(self) -> dict[str, Any]:
        health = self.home.health().get("robot")
        if health is None or health.state != "active" or not health.is_alive:
            return {"why_not_arm": None}
        return {"why_not_arm": None} | health.detail

    def twin(self) -> dict[str, Any]:
        return self.home.health()["robot-twin"].detail

    def arm(self) -> None:
        with Station(self.home.bus.url) as station:
            if self.twin()["controller"]:
                station.release_motors()
            self.wait_until_ready()
            wait_until(lambda: self._is_armed(station))
        wait_until(lambda: self.twin()["is_stiff"])

    def _is_armed(self, station: Station) -> bool:
        try:
            station.arm()
        except Refused:  # by what has come up since the robot was ready; a robot of another moment may be armed
            return False
        return True

    def close(self) -> None:
        self.guard.kill()
        self.guard.wait()


@pytest.fixture(scope="module")
def lab(plain: Path, processes: None, real_time: None) -> Iterator[Lab]:
    with new_home() as home, domain() as number, ExitStack() as stack:
        found = Lab(home, number, plain, stack)
        stack.callback(found.close)
        yield found


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "frozen"])
def test_r10_when_the_server_of_the_robot_goes_the_motors_are_damped_and_nothing_but_arming_moves_it(lab, how):
    lab.start_robot()
    lab.arm()
    pid = lab.home.pids()["robot"]
    os.kill(pid, how)
    wait_until(lambda: lab.twin()["is_damped"])
    if how == signal.SIGSTOP:
        os.kill(pid, signal.SIGCONT)  # its commands go on, and move nothing
        wait_until(lambda: lab.home.health()["robot"].detail["arming"] == "disarmed")
        os.kill(pid, signal.SIGINT)
    lab.server.process.wait(60.0)
    lab.start_robot()
    lab.wait_until_ready()
    assert lab.twin()["is_damped"], "a new server moves nothing before it is armed"
    lab.arm()
    with Station(lab.home.bus.url) as station:
        station.disarm()
    wait_until(lambda: lab.twin()["is_damped"])
    os.kill(lab.home.pids()["robot"], signal.SIGINT)
    lab.server.process.wait(60.0)


def test_r11_a_guard_that_is_killed_is_named_and_the_robot_given_up(lab):
    lab.start_robot()
    lab.arm()
    lab.guard.kill()
    lab.guard.wait()
    wait_until(lambda: lab.home.health()["robot"].detail["arming"] == "disarmed")
    assert "the guard at 127.0.0.1" in lab.robot()["why_not_arm"]
    assert lab.twin()["is_stiff"], "this firmware holds the last command: what a second guard is for"
    with Station(lab.home.bus.url) as station, pytest.raises(Refused, match="does not answer"):
        station.arm()
    lab.guard = lab.start_guard()
    lab.wait_until_ready()
    lab.arm()
