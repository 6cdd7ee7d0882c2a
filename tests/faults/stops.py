"""The emergency stop as any client writes it, and which steps of the robot came after it."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing

from station.bus import keys
from station.bus.connection import Connection
from tests.cli.running import Home, are_gone, new_home
from tests.faults.onlooker import Onlooker, Step
from tests.servers.g1_station import LIGHT
from tests.waiting import wait_until

PERIOD_S = 0.02
LIGHT_G1 = [word for setting in LIGHT for word in ("--set", f"g1.{setting}")]


class Stop:
    """A stop that is written now, by a client without stamps.

    Args:
        onlooker: Sees the steps.
        line: To the bus.
    """

    def __init__(self, onlooker: Onlooker, line: Connection) -> None:
        self._onlooker = onlooker
        self._since_ns = time.monotonic_ns()
        line.call("SET", keys.ESTOP, b"1")

    @property
    def steps(self) -> list[Step]:
        """Those that were published since."""
        return self._onlooker.since(self._since_ns)

    def wait_until_damped(self, otherwise: Callable[[], bool] = lambda: False) -> None:
        """Wait until a step is; from then on, all of them."""
        wait_until(lambda: any(step.damped for step in self.steps) or otherwise())
        self.expect_latched()

    def expect_latched(self) -> None:
        """Fail where a step after the first damped one has stiffness, or is not stopped."""
        damped = [step.damped and step.gate == "stopped" for step in self.steps]
        assert damped == sorted(damped), "once stopped, it stays so"

    def damped_after_s(self) -> float:
        """Return the time from the write to the first step that is damped [s]."""
        return (next(step for step in self.steps if step.damped).mono_ns - self._since_ns) * 1e-9

    def late_s(self) -> float:
        """Return by how much the last step with stiffness came too late: it may be the one under way [s]."""
        stiff = [step for step in self.steps[1:] if not step.damped]
        return (stiff[-1].mono_ns - self._since_ns) * 1e-9 - PERIOD_S if stiff else 0.0


def stop_without_supervisor() -> Stop:
    """Kill the supervisor of a robot that moves, and write a stop: the robot is damped, and its server ends."""
    with new_home() as home, home.running("bus", "start") as bus:
        assert bus.process.stdout is not None
        bus.process.stdout.readline()
        with home.running("up", "g1-sim-motion", "--yes", "--set", "motion.loop=true", *LIGHT_G1) as station:
            station.wait_for("to=tracking")
            pids = list(home.pids().values())
            with Onlooker(home.bus) as onlooker, closing(Connection(home.bus, timeout_s=5.0)) as line:
                wait_until(lambda: onlooker.steps)
                station.process.kill()
                stop = Stop(onlooker, line)  # as a person would press it who sees the robot go on
                stop.wait_until_damped(otherwise=lambda: are_gone(pids))
                wait_until(lambda: are_gone(pids))
                stop.expect_latched()
            assert _finalized(home, "g1"), "it ended by itself, in the robot's safe state"
    return stop


def _finalized(home: Home, name: str) -> bool:
    return home.health()[name].state == "finalized"
