"""What can befall a whole station: each does it, waits until the robot follows again, and tells how long what matters
took."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from random import Random

from station.bus import keys
from station.bus.connection import Connection
from tests.faults.control_trials import CLIPS
from tests.faults.moving_station import MovingStation
from tests.waiting import wait_until

Fault = Callable[[MovingStation, Random], float | None]
KILLS_THE_BUS = "kill bus"


def kill_recorder(station: MovingStation, _: Random) -> None:
    """Its supervisor starts it again; nobody waits for it."""
    station.kill("recorder")


def kill_motion(station: MovingStation, random: Random) -> float:
    """Return the time until the robot stood; another motion follows."""
    seconds = _until(station, "waiting", station.kill("motion"))
    station.end_motion()
    station.play(random.choice(CLIPS))
    return seconds


def freeze_motion(station: MovingStation, random: Random) -> float:
    """Return the time until its last command was held."""
    at_ns = station.freeze("motion")
    seconds = _until(station, "holding", at_ns)
    station.wait_s(random.uniform(0.0, 3.0))
    station.wait_for_gate("tracking", station.thaw("motion"))
    return seconds


def cut_motion(station: MovingStation, random: Random) -> float:
    """Return the time until its last command was held."""
    at_ns = station.cut()
    seconds = _until(station, "holding", at_ns)
    station.wait_s(random.uniform(0.0, 3.0))
    since_ns = time.monotonic_ns()
    station.line.mend()
    station.wait_for_gate("tracking", since_ns)
    return seconds


def kill_robot(station: MovingStation, _: Random) -> float:
    """Return the time until a new one followed; of a simulation, which starts on its feet."""
    at_ns = station.kill("g1")
    station.start_again("g1")
    return _until(station, "tracking", at_ns)


def freeze_bus(station: MovingStation, random: Random) -> float:
    """Return the time until the robot followed again, from the end of the frost."""
    os.kill(station.server.pid, signal.SIGSTOP)
    time.sleep(random.uniform(0.1, 2.0))  # the length of the frost
    at_ns = time.monotonic_ns()
    os.kill(station.server.pid, signal.SIGCONT)
    return _until(station, "tracking", at_ns)


def cut_everybody(station: MovingStation, random: Random) -> float:
    """Return the time until the robot followed again."""
    at_ns = time.monotonic_ns()
    line = Connection(station.address, timeout_s=5.0)
    line.call("CLIENT", "KILL", "TYPE", random.choice(["normal", "replica", "pubsub"]), "SKIPME", "yes")
    line.close()
    return _until(station, "tracking", at_ns)


def stop_robot(station: MovingStation, random: Random) -> float:
    """Return the time from a stock client's ``SET`` to the first targets without stiffness; another motion follows."""
    line = Connection(station.address, timeout_s=5.0)
    at_ns = time.monotonic_ns()
    line.call("SET", keys.ESTOP, b"1")
    wait_until(lambda: any(step.damped for step in station.onlooker.since(at_ns)))
    first_ns = next(step.mono_ns for step in station.onlooker.since(at_ns) if step.damped)
    reset_ns = time.monotonic_ns()
    line.call("SET", keys.ESTOP, b"0")
    line.close()
    station.wait_for_gate("waiting", reset_ns)
    station.end_motion()  # the stop has ended it, or is about to
    station.play(random.choice(CLIPS))
    return (first_ns - at_ns) * 1e-9


def kill_bus(station: MovingStation, _: Random) -> float:
    """Return the time until the robot followed again."""
    at_ns = station.kill_bus()
    station.start_bus()
    return _until(station, "tracking", at_ns)


FAULTS: dict[str, Fault] = {
    "kill recorder": kill_recorder,
    "kill motion": kill_motion,
    "freeze motion": freeze_motion,
    "cut motion's line": cut_motion,
    "kill g1": kill_robot,
    "freeze bus": freeze_bus,
    "cut all lines": cut_everybody,
    "e-stop": stop_robot,
    KILLS_THE_BUS: kill_bus,
}


def _until(station: MovingStation, gate: str, at_ns: int) -> float:
    """Wait until the gate is in a state; return the time of that since an instant [s]."""
    station.wait_for_gate(gate, at_ns)
    return (next(step.mono_ns for step in station.onlooker.since(at_ns) if step.gate == gate) - at_ns) * 1e-9
