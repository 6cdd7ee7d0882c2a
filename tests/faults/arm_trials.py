"""An arm that is moved while something is killed or frozen, and its simulated controller, which keeps the time.

The controller runs apart from everything that is killed, in a thread of the tests that holds no lock of Python: what it
does after a kill is what an arm would do.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import takewhile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from adapters.devices.spacemouse.kind import SpacemouseConfig
from servers.teleop import TeleopConfig
from station.bus import codec, keys
from station.supervision.supervisor import Supervisor
from tests.faults.bus_station import frozen
from tests.servers.kassow_station import ROBOT, TIMEOUT_S, ArmStation
from tests.waiting import wait_until

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


class Followed(NamedTuple):
    """What an arm did while a commander wrote through a frozen bus, after a stop and its release.

    Attributes:
        gates: States of its gate since the release.
        gap_s: For how long the commander wrote nothing while it could, at most [s].
    """

    gates: list[str]
    gap_s: float


def write_through_a_frozen_bus(kord: Any, folder: Path, frozen_s: float, **arm_settings: Any) -> Followed:
    """Stop and release an arm, then freeze the bus, while a commander never lets go; another one is followed after."""
    socket = folder / "controller.sock"
    with (
        kord.ControllerServer(socket) as controller,
        ArmStation(folder, host=f"unix:{socket}", **arm_settings) as arm,
    ):
        with StockCommander(arm) as commander:
            arm.wait_for_gate("tracking")
            arm.bus.publish({keys.ESTOP: b"1"})
            arm.wait_for_gate("stopped")
            arm.bus.publish({keys.ESTOP: b"0"})
            arm.wait_for_gate("waiting")
            with frozen(arm.server.pid):
                wait_for_ticks(controller, frozen_s)
            wait_for_ticks(controller, 0.5)
            gap_s = commander.stop()
            told = [codec.parse_json(value) for value in arm.log.values(keys.command_gate(ROBOT))]
        # The log comes by another line than what was waited for, and later: it says itself when the stop was released.
        gates = list(takewhile(lambda gate: gate["state"] != "stopped", reversed(told)))[::-1]
        assert 50 < len(gates) < len(told), "it was stopped, and then seen"
        arm.settle()
        with StockCommander(arm):
            arm.wait_for_gate("tracking")
    return Followed([str(gate["state"]) for gate in gates], gap_s)
