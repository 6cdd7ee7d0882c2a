"""A whole station that moves, under test: bus, recorder, G1 server and motion server, at the pace of the clock."""

from __future__ import annotations

import math
import os
import signal
import time
from pathlib import Path
from types import TracebackType
from typing import Any

from servers.g1 import G1Config
from servers.motion import MotionConfig
from servers.recorder import RecorderConfig
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.redis_server import RedisServer, ServerOptions
from station.episode.recorder import remote
from station.episode.storage.request import RecordAnswer
from station.errors import BusError
from station.life.restarts import Restarts
from station.life.server import Health, read_health
from station.protocols import FALL_TILT_RAD
from station.supervision.supervisor import Supervisor
from tests.faults.cuttable_line import CuttableLine
from tests.faults.onlooker import Onlooker
from tests.waiting import wait_until

UPRIGHT_M = 0.4
"""A pelvis below has sat down or fallen; the built-in squat asks for 0.52 [m]."""


class MovingStation:
    """A context manager; leaves no process behind.

    The command server reaches the bus over a line of its own, which can be cut.

    Args:
        folder: For everything that is written.
        record: Whether there is a recorder.
        g1: Settings of the G1 server beside its defaults.
    """

    def __init__(self, folder: Path, *, record: bool = True, **g1: Any) -> None:
        self.folder, self.data = folder, folder / "data"
        self._options = ServerOptions(folder=folder, socket=folder / "bus.sock")
        self.server = RedisServer.start(self._options)
        self.bus = Bus(self.address, name="supervisor", timeout_s=5.0)
        self.line = CuttableLine(folder / "line.sock", self.address)
        self._line_bus = Bus(self.line.address, name="supervisor-too", timeout_s=5.0)
        self.supervisor = Supervisor(self.bus, folder / "logs")
        self._commanders = Supervisor(self._line_bus, folder / "logs")
        self.onlooker = Onlooker(self.address)
        try:
            self._start("g1", G1Config(**g1))
            if record:
                self._start("recorder", RecorderConfig(data=self.data, min_free_mb=0), Restarts())
        except BaseException:
            self.close()
            raise

    @property
    def address(self) -> BusAddress:
        return self.server.address

    # -- Servers ---------------------------------------------------------------------------------------------------
    def play(self, motion: str, **settings: Any) -> None:
        """Start a motion server, which plays over and over, and wait until the robot follows it."""
        self._start("motion", MotionConfig(motion=motion, loop=True, **settings))
        self.wait_for_gate("tracking", time.monotonic_ns())  # it has loaded: one before has been silent for long

    def end_motion(self) -> None:
        """Make an end of the motion server: at once, for the gate takes the robot to standing all the same."""
        self._commanders.children["motion"].process.kill()
        self._commanders.stop("motion")

    def pid(self, name: str) -> int:
        return self._of(name).children[name].process.pid

    def kill(self, name: str) -> int:
        """``kill -9`` a server; return the instant before [ns]."""
        return self._signal(self.pid(name), signal.SIGKILL)

    def freeze(self, name: str) -> int:
        """Stop a server where it stands; return the instant before [ns]."""
        return self._signal(self.pid(name), signal.SIGSTOP)

    def thaw(self, name: str) -> int:
        """Let a frozen server go on; return the instant before [ns]."""
        return self._signal(self.pid(name), signal.SIGCONT)

    def cut(self) -> int:
        """Cut the line of the command server; return the instant before [ns]."""
        at_ns = time.monotonic_ns()
        self.line.cut()
        return at_ns

    def start_again(self, name: str) -> None:
        """Start a server again that was killed, and wait until it is active."""
        supervisor = self._of(name)
        supervisor.start_again(name)
        supervisor.wait_for(name, "active", 60)

    def kill_bus(self) -> int:
        """``kill -9`` the bus; return the instant before [ns]."""
        at_ns = self._signal(self.server.pid, signal.SIGKILL)
        wait_until(lambda: not self.server.is_running)
        return at_ns

    def start_bus(self) -> None:
        """Start the bus again, on the same socket."""
        self.server.stop()  # clears away what the dead one left
        self.server = RedisServer.start(self._options)
        self._wait_for_lines()

    def mend(self) -> None:
        """Mend the line of the command server."""
        self.line.mend()
        self._wait_for_lines()

    # -- What it does ------------------------------------------------------------------------------------------------
    def wait_for_gate(self, state: str, since_ns: int = 0) -> None:
        """Wait until the gate has been in a state after an instant [ns]."""
        wait_until(lambda: any(step.gate == state for step in self.onlooker.since(since_ns)))

    def wait_s(self, seconds: float) -> None:
        """Wait until the robot has made the steps of so many seconds from now on: in its time, however slow it is."""
        since_ns = time.monotonic_ns()
        wait_until(lambda: len(self.onlooker.since(since_ns)) >= seconds * 50)

    def health(self, name: str) -> Health | None:
        try:
            return next((health for health in read_health(self.bus) if health.name == name), None)
        except BusError:
            return None

    def falls(self, since_ns: int = 0) -> int:
        """Return how often the robot fell after an instant: as it says itself, or as its pose shows."""
        told = len(self.onlooker.named("fall", since_ns))
        is_down = any(not self._stood(step.tilt_rad, step.height_m) for step in self.onlooker.since(since_ns))
        return max(told, int(is_down))

    def worst_lean_deg(self, since_ns: int = 0) -> float:
        """Return how far the pelvis leaned at most after an instant [deg]."""
        return math.degrees(max((step.tilt_rad for step in self.onlooker.since(since_ns)), default=0.0))

    def lowest_m(self, since_ns: int = 0) -> float:
        """Return how low the pelvis came after an instant [m]."""
        return min((step.height_m for step in self.onlooker.since(since_ns)), default=math.inf)

    def is_upright(self) -> bool:
        """Whether the robot stands now."""
        last = self.onlooker.steps[-1]
        return self._stood(last.tilt_rad, last.height_m)

    def log(self, name: str) -> str:
        """Return what a server has printed."""
        return Path(self._of(name).children[name].process.log).read_text(errors="replace")

    def ask(self, action: Any, **fields: Any) -> RecordAnswer:
        """Ask the recorder for something."""
        return remote.ask(self.bus, action, timeout_s=60.0, **fields)

    def close(self) -> None:
        self.onlooker.close()
        for supervisor in (self._commanders, self.supervisor):
            for name, child in supervisor.children.items():
                if name == "motion":
                    child.process.kill()  # else it would take its two seconds to blend out
            supervisor.stop_all()
        self._line_bus.close()
        self.line.close()
        self.bus.close()
        self.server.stop()

    def __enter__(self) -> MovingStation:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _wait_for_lines(self) -> None:
        """Wait until our own lines to the bus are back: one that was idle learns that it was cut when it is used."""
        wait_until(lambda: all(_answers(bus) for bus in (self.bus, self._line_bus)))

    @staticmethod
    def _stood(tilt_rad: float, height_m: float) -> bool:
        return tilt_rad < FALL_TILT_RAD and height_m > UPRIGHT_M

    def _of(self, name: str) -> Supervisor:
        return self._commanders if name == "motion" else self.supervisor

    def _start(self, name: str, config: Any, restarts: Restarts | None = None) -> None:
        supervisor = self._of(name)
        supervisor.spawn(name, config, restarts=restarts)
        supervisor.wait_for(name, "inactive", 60)
        supervisor.activate(name)
        supervisor.wait_for(name, "active", 60)

    @staticmethod
    def _signal(pid: int, number: signal.Signals) -> int:
        at_ns = time.monotonic_ns()
        os.kill(pid, number)
        return at_ns


def stands_without_a_bus(station: MovingStation) -> list[str]:
    """Take the bus away for good while the robot walks: it stands; return the states of its gate."""
    station.play("builtin:walk-forward", enter_s=0.1)
    station.wait_s(1.0)
    known = len(station.log("g1"))
    station.kill_bus()
    # No event can be read now; the server's log has them, and it counts its falls.
    wait_until(lambda: "from=returning to=waiting" in station.log("g1")[known:])
    lines = station.log("g1")[known:].splitlines()
    gates = [line.partition("gate ")[2].split()[1] for line in lines if " gate " in line]
    station.start_bus()  # to ask how it stands
    wait_until(lambda: (health := station.health("g1")) is not None and health.detail.get("gate") is not None)
    station.wait_s(0.5)
    health = station.health("g1")
    assert health is not None
    assert health.detail["falls"] == 0
    assert station.is_upright()
    return [gate.removeprefix("to=") for gate in gates]


def _answers(bus: Bus) -> bool:
    try:
        bus.call("PING")
    except BusError:
        return False
    return True
