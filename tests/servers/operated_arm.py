"""An arm that an operator drives, under test: bus, fake spacemouse and teleoperation server, each a process of its own,
and an arm that does what it is told in place of a controller."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from adapters.commands.arm import arm_command
from adapters.devices.spacemouse.kind import SpacemouseConfig
from adapters.robots import arm_limits
from adapters.robots.kassow.names import KR810_ROBOT
from servers.teleop import TeleopConfig
from station.bus import codec, keys
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.control.arm_control import ArmControl
from station.control.command_validator import CommandSample
from station.control.gate import GateConfig
from station.life.events import Event
from station.life.loop import Rate
from station.protocols import Floats
from station.supervision.supervisor import Supervisor
from tests.control.ideal_arm import TICK_S, IdealArm
from tests.servers.g1_station import Log
from tests.waiting import wait_until

ROBOT = KR810_ROBOT
TIMEOUT_S = 60.0
PATIENT = GateConfig(hold_after_s=1.0, return_after_s=3.0)
"""These tests are about who drives, and not about an arm whose commands are late: that is the gate's."""
_NOT_HEARD = "has not said where it is"  # how the teleoperation server speaks of an arm


class ArmAtWork:
    """The low-level side of an arm, in a thread: `ArmControl` over an arm without a controller."""

    def __init__(self, address: Any) -> None:
        self.session = IdealArm()
        command_format = arm_command("kassow", arm_limits.load("kassow", "kr810"))
        self.control = ArmControl(self.session, command_format, gate=PATIENT, is_armed=True)
        self._bus = Bus(address, name="arm", timeout_s=5.0)
        self._watch = self._bus.watch([keys.action_joints(ROBOT)])
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Let the arm go."""
        self._stop.set()
        self._thread.join(60)
        self._watch.close()
        self._bus.close()

    def _run(self) -> None:
        rate, seen, sample = Rate(1.0 / TICK_S), None, None
        while not self._stop.is_set():
            rate.wait()
            self.session.pass_tick()
            newest = self._watch.latest(keys.action_joints(ROBOT))
            if newest is not None and newest is not seen:
                seen, arrived_ns = newest, newest.arrived_ns
                sample = CommandSample(newest.value, None if arrived_ns is None else arrived_ns * 1e-9)
            state = self.control.sense()
            record = self.control.step(state, sample, time.monotonic_ns() * 1e-9)
            self._bus.publish(
                {
                    keys.state_joints(ROBOT): codec.f64(np.concatenate([state.q, np.zeros(14)])),
                    keys.command_used(ROBOT): codec.f64(record.decision.vector),
                    keys.command_gate(ROBOT): codec.json_object(self.control.commanded.status(record.decision)),
                }
            )


class OperatedArm:
    """A context manager; leaves no process behind.

    Args:
        folder: For everything that is written.
        steps: Of the fake spacemouse's script.
        teleop: Settings of the teleoperation server.
    """

    def __init__(self, folder: Path, steps: Sequence[Mapping[str, Any]], **teleop: Any) -> None:
        script = folder / "script.json"
        script.write_text(json.dumps({"device": "spacemouse", "steps": list(steps)}))
        self._spacemouse = SpacemouseConfig(fake=script)
        self.server = RedisServer.start(ServerOptions(folder=folder, socket=folder / "bus.sock"))
        self.bus = Bus(self.server.address, name="supervisor", timeout_s=5.0)
        self.log = Log(self.server.address)
        self.supervisor = Supervisor(self.bus, folder / "logs")
        self.arm: ArmAtWork | None = None
        try:
            self._start("teleop", TeleopConfig(device="spacemouse", **({"driver": "arm-tcp"} | teleop)))
        except BaseException:
            self.close()
            raise

    def start_arm(self) -> ArmAtWork:
        """Let there be an arm, and wait until the teleoperation server knows where it is."""
        self.arm = ArmAtWork(self.server.address)
        wait_until(lambda: (why := self._why_not()) and _NOT_HEARD not in why, TIMEOUT_S)
        return self.arm

    def start_script(self) -> None:
        """Let the operator begin."""
        self._start("spacemouse", self._spacemouse)

    def _why_not(self) -> str:
        """Return what the status line says of why nobody drives; "" where nothing is known."""
        health = self.supervisor.health("teleop")
        return str(health.detail.get("why_not", "")) if health is not None else ""

    def told(self, *names: str) -> list[Event]:
        """Return the events of some names, in order."""
        return self.log.events(*names)

    def wait_for(self, name: str, count: int = 1) -> Event:
        """Wait until something was told so often; return the event."""
        return self.log.wait_for(name, count, TIMEOUT_S)

    def commands(self) -> Floats:
        """Return all commands, shape (n, 7) [rad]."""
        return np.array([codec.parse_json(value) for value in self.log.values(keys.action_joints(ROBOT))])

    def close(self) -> None:
        """Stop everything."""
        self.log.close()
        if self.arm is not None:
            self.arm.close()
        self.supervisor.stop_all()
        self.bus.close()
        self.server.stop()

    def __enter__(self) -> OperatedArm:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _start(self, name: str, config: Any) -> None:
        self.supervisor.spawn(name, config)
        self.supervisor.wait_for(name, "inactive", TIMEOUT_S)
        self.supervisor.activate(name)
        self.supervisor.wait_for(name, "active", TIMEOUT_S)
