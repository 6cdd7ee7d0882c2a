"""Whatever is killed while an arm moves, the arm comes to rest: by its controller's clock, within 200 ms.

The simulated controller runs apart from everything that is killed, in a thread of the tests that holds no lock of
Python, and keeps the time: what it does after a kill is what an arm would do.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from servers.spacemouse import SpacemouseConfig
from servers.teleop import TeleopConfig
from station.bus import codec, keys
from station.supervision.supervisor import Supervisor
from tests.faults.bus_station import frozen
from tests.lateness import TooLate, Waits, excuse
from tests.servers.kassow_station import ROBOT, TIMEOUT_S, ArmStation
from tests.waiting import wait_until

STANDS_WITHIN_TICKS = 50  # of 4 ms: 200 ms


def script(seconds: int = 120) -> str:
    """An operator who pushes joints to and fro, and turns driving on and off again every few seconds: a press that
    comes too early, on a busy machine, is followed by another."""
    presses = [{"at_s": at_s, "buttons": [0]} for at_s in range(1, seconds, 4)]
    presses += [{"at_s": at_s + 0.2, "buttons": []} for at_s in range(1, seconds, 4)]
    pushes = [{"at_s": at_s + 0.5, "twist": [0, 0, 0, 0, 0, (-1.0) ** at_s]} for at_s in range(seconds)]
    steps = sorted([*presses, *pushes], key=lambda step: float(str(step["at_s"])))
    return json.dumps({"device": "spacemouse", "period_s": float(seconds + 1), "steps": steps})


class OperatedArm:
    """An arm that an operator's fake spacemouse moves, and its controller.

    Args:
        station: Bus and the arm's server.
        controller: The simulated controller.
    """

    def __init__(self, station: ArmStation, controller: Any) -> None:
        self.station, self.controller = station, controller

    def pid(self, name: str) -> int:
        """Process id of a server, or of the bus."""
        if name == "bus":
            return self.station.server.pid
        supervisor: Supervisor = self.station.supervisor
        return supervisor.children[name].process.pid

    def wait_for_motion(self) -> None:
        """Wait until joints move at a good part of their speed."""
        wait_until(lambda: float(np.abs(self.controller.simulator.trace(1)["qd"]).max()) > 0.1, TIMEOUT_S)

    def ticks_to_rest(self, since: int) -> int:
        """Wait until the arm has stood for half a second; return how many ticks after `since` it last moved."""

        def stood() -> bool:
            rows = self.controller.simulator.trace(125)
            return bool(rows["tick"][0] > since and not rows["moving"].any())

        wait_until(stood, TIMEOUT_S)
        rows = self.controller.simulator.trace()
        after = rows[rows["tick"] > since]
        moving = after["tick"][np.flatnonzero(after["moving"])]
        return int(moving[-1] - since) if len(moving) else 0


@contextmanager
def operated(kord: Any, folder: Path) -> Iterator[OperatedArm]:
    socket = folder / "controller.sock"
    with kord.ControllerServer(socket) as controller, ArmStation(folder, host=f"unix:{socket}") as station:
        fake = folder / "script.json"
        fake.write_text(script())
        station.start("teleop", TeleopConfig(device="spacemouse", driver="arm-joints"))
        station.start("spacemouse", SpacemouseConfig(fake=fake))
        yield OperatedArm(station, controller)


def kill(arm: OperatedArm, name: str) -> int:
    """``kill -9`` in motion; return the controller's tick by then."""
    arm.wait_for_motion()
    os.kill(arm.pid(name), signal.SIGKILL)
    return int(arm.controller.simulator.tick)


@pytest.mark.parametrize("name", ["kassow", "teleop", "bus"])
def test_the_arm_stands_within_200_ms_of_a_kill(kord: Any, tmp_path: Path, name: str) -> None:
    with operated(kord, tmp_path) as arm:
        since = kill(arm, name)
        assert arm.ticks_to_rest(since) <= STANDS_WITHIN_TICKS
        assert arm.controller.simulator.trace()["fault"].max() == 0


SILENT_S = 0.25  # the gate takes 0.3 s without a command for somebody who let go

_STOCK = """
import json, math, sys, threading, time
import redis

line, key, q = redis.Redis(unix_socket_path=sys.argv[1]), sys.argv[2], json.loads(sys.argv[3])
ended = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
began_s = written_s = time.monotonic()
longest_s = 0.0
while not ended.wait(0.004):
    now_s = time.monotonic()
    longest_s = max(longest_s, now_s - written_s)
    line.set(key, json.dumps([q[0] + 0.2 * math.sin(now_s - began_s), *q[1:]]))
    written_s = time.monotonic()
print(longest_s, flush=True)
"""


class StockCommander:
    """A foreign process that moves joint 1 to and fro from where the arm is, and does not let go, whatever happens."""

    def __init__(self, arm: ArmStation) -> None:
        words = [arm.server.address.socket or "", keys.action_joints(ROBOT), json.dumps(arm.joints().tolist())]
        self._process = subprocess.Popen(
            [sys.executable, "-c", _STOCK, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def stop(self) -> float:
        """Let go; return for how long it wrote nothing while it could [s]."""
        out, _ = self._process.communicate("", timeout=TIMEOUT_S)
        return float(out)

    def __enter__(self) -> StockCommander:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.communicate()


def wait_for_ticks(controller: Any, seconds: float) -> None:
    """Let time pass by the controller's clock, whatever becomes of the bus."""
    since = controller.simulator.tick
    wait_until(lambda: controller.simulator.tick >= since + seconds * 250, TIMEOUT_S)


@pytest.mark.parametrize("frozen_s", [0.6, 3.0])
def test_who_goes_on_writing_through_a_frozen_bus_after_a_stop_is_not_followed_when_it_is_back(
    kord: Any, tmp_path: Path, frozen_s: float
) -> None:
    socket = tmp_path / "controller.sock"
    with kord.ControllerServer(socket) as controller, ArmStation(tmp_path, host=f"unix:{socket}") as arm:
        with Waits.watched() as waits, StockCommander(arm) as commander:
            arm.wait_for_gate("tracking")
            arm.bus.publish({keys.ESTOP: b"1"})
            arm.wait_for_gate("stopped")
            arm.bus.publish({keys.ESTOP: b"0"})
            arm.wait_for_gate("waiting")
            since = len(arm.log.values(keys.command_gate(ROBOT)))
            with frozen(arm.server.pid):
                wait_for_ticks(controller, frozen_s)  # longer than a silence
            wait_for_ticks(controller, 0.5)
            gap_s = commander.stop()
            gates = [codec.parse_json(value) for value in arm.log.values(keys.command_gate(ROBOT))[since:]]
            waits.seconds()
        assert len(gates) > 50
        if any(gate["state"] != "waiting" for gate in gates):
            assert gap_s > SILENT_S, "it never let go, and was followed"
            excuse(TooLate("the commander", SILENT_S / 2, waits.longest_s))
        arm.settle()
        with StockCommander(arm):
            arm.wait_for_gate("tracking")
