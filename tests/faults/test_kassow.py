"""Whatever is killed while an arm moves, the arm comes to rest: by its controller's clock, within 200 ms.

The simulated controller runs apart from everything that is killed, in a thread of the tests that holds no lock of
Python, and keeps the time: what it does after a kill is what an arm would do.
"""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from servers.spacemouse import SpacemouseConfig
from servers.teleop import TeleopConfig
from station.supervision.supervisor import Supervisor
from tests.servers.kassow_station import TIMEOUT_S, ArmStation
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
