"""A G1 that an operator drives, under test: bus, G1, fake device, teleoperation server, each a process of its own."""

from __future__ import annotations

import json
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from servers.g1 import G1Config
from servers.pico import PicoConfig
from servers.recorder import RecorderConfig
from servers.teleop import TeleopConfig
from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.bus.tap import Write
from station.life import events
from station.life.events import Event
from station.life.restarts import Restarts
from station.life.supervisor import Supervisor
from station.protocols import FALL_TILT_RAD, Floats
from station.rotations import tilt
from tests.servers.g1_station import ROBOT, Log
from tests.waiting import wait_until

UPRIGHT_M = 0.4
TIMEOUT_S = 90.0
_HALF_A_SECOND = 25  # steps


class OperatedStation:
    """A context manager; leaves no process behind.

    Args:
        folder: For everything that is written.
        controls: Of the fake Pico's script; its body does `motion`.
        faults: Of the script.
        motion: What the fake operator does.
        record: Whether there is a recorder.
        start_armed: Whether the robot starts armed.
        teleop: Settings of the teleoperation server.
    """

    def __init__(
        self,
        folder: Path,
        controls: Sequence[Mapping[str, Any]],
        faults: Sequence[Mapping[str, Any]] = (),
        *,
        motion: str = "builtin:wave",
        record: bool = False,
        start_armed: bool = True,
        **teleop: Any,
    ) -> None:
        self.data = folder / "data"
        self._fake = folder / "script.json"
        script = {"motion": motion, "repeat": "swing", "controls": list(controls), "faults": list(faults)}
        self._fake.write_text(json.dumps(script))
        self.server = RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock"))
        self.bus = Bus(self.server.address, name="supervisor", timeout_s=5.0)
        self.log = Log(self.server.address)
        self.supervisor = Supervisor(self.bus, folder / "logs")
        try:
            self._start("g1", G1Config(physics_dt_s=0.002, real_time_priority=0, start_armed=start_armed))
            if record:
                self._start("recorder", RecorderConfig(data=self.data, min_free_mb=0))
            self._start("teleop", TeleopConfig(device="pico", **teleop))
            self._start("pico", PicoConfig(fake=self._fake), Restarts())
        except BaseException:
            self.close()
            raise

    def told(self, *names: str) -> list[Event]:
        """Return the events of some names, in order."""
        found = [events.decode(value) for value in self.log.values(keys.EVENT)]
        return [event for event in found if event is not None and event.name in names]

    def wait_for(self, name: str, count: int = 1) -> Event:
        """Wait until something was told so often; return the event."""
        wait_until(lambda: len(self.told(name)) >= count, TIMEOUT_S)
        return self.told(name)[count - 1]

    def why_not(self) -> str:
        """Return what the status line says of why nobody drives; "" where nothing is known."""
        health = self.supervisor.health("teleop")
        return str(health.detail.get("why_not", "")) if health is not None else ""

    def wait_for_gate(self, state: str) -> None:
        """Wait until the gate is in a state."""
        wait_until(lambda: self.log.gate()["state"] == state, TIMEOUT_S)

    def wait_for_end(self) -> int:
        """Wait until the teleoperation server has ended by itself; return its exit code."""
        process = self.supervisor.children["teleop"].process
        wait_until(lambda: process.poll() is not None, TIMEOUT_S)
        return int(process.returncode)

    def commands(self) -> list[tuple[int, Floats]]:
        """Return all commands with their places in the log."""
        return self._vectors(keys.action_body(), codec.parse_json)

    def used(self) -> list[tuple[int, Floats]]:
        """Return the commands that the robot followed, with their places in the log."""
        return self._vectors(keys.command_used(ROBOT), codec.parse_f64)

    def is_upright(self) -> bool:
        """Whether the robot has stood all the time."""
        poses = [codec.parse_f64(value) for value in self.log.values(keys.sim_qpos(ROBOT))]
        return all(float(tilt(pose[3:7])) < FALL_TILT_RAD and pose[2] > UPRIGHT_M for pose in poses)

    def restarts_at_engaging(self) -> list[float]:
        """Return, for each engaging, how far the first command was from what the robot was asked for before it: by us,
        or, where nobody commanded, from what it followed."""
        commands, used = self.commands(), self.used()
        jumps, was_engaged = [], False
        for place, write in self._writes():
            if write.key != keys.command_source(ROBOT):
                continue
            is_engaged = bool(codec.parse_json(write.value or b"")["engaged"])
            if is_engaged and not was_engaged:  # the source comes after the command in their common write
                count = bisect_left(commands, place, key=lambda found: found[0])
                followed = used[: bisect_left(used, place, key=lambda found: found[0])]
                was_silent = count < 2 or commands[count - 2][0] < followed[-_HALF_A_SECOND][0]
                before = followed[-1][1] if was_silent else commands[count - 2][1]
                jumps.append(float(np.abs(commands[count - 1][1] - before).max()))
            was_engaged = is_engaged
        return jumps

    def close(self) -> None:
        self.log.close()
        if "teleop" in self.supervisor.children:
            self.supervisor.children["teleop"].process.kill()  # else it would take its two seconds to blend out
        self.supervisor.stop_all()
        self.bus.close()
        self.server.stop()

    def __enter__(self) -> OperatedStation:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _vectors(self, key: str, parse: Any) -> list[tuple[int, Floats]]:
        return [(index, np.array(parse(write.value))) for index, write in self._writes() if write.key == key]

    def _writes(self) -> list[tuple[int, Write]]:
        return [(index, write) for index, write in enumerate(list(self.log.writes)) if write.value is not None]

    def _start(self, name: str, config: Any, restarts: Restarts | None = None) -> None:
        self.supervisor.spawn(name, config, restarts=restarts)
        self.supervisor.wait_for(name, "inactive", 60)
        self.supervisor.activate(name)
        self.supervisor.wait_for(name, "active", 60)
