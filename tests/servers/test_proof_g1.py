"""The G1 server keeps its time: a stop within a step, a ramp of two seconds, a loop that needs no bus."""

from __future__ import annotations

from pathlib import Path
from tempfile import mkdtemp

import pytest

from station.bus.address import BusAddress
from station.bus.redis_server import ServerOptions
from tests.figures import Figures
from tests.lateness import TooLate, Waits, in_time
from tests.servers.g1_station import LIGHT
from tests.servers.g1_trials import PERIOD_S, arm, stop_and_reset, take_the_bus_away

RAMP_TICKS = 80  # of a hundred in two seconds


@pytest.mark.parametrize("stop", [b"1", b'{"stop": true, "who": "anna", "reason": "smoke"}'])
def test_the_emergency_stop_damps_within_one_step(bus_server: BusAddress, stop: bytes, proof: Figures) -> None:
    def once() -> None:
        with Waits.watched() as waits:
            late_s = stop_and_reset(bus_server, stop, *LIGHT)
        if late_s > 0.0:
            raise TooLate("the stop", late_s, waits.longest_s)

    in_time(once)


def test_arming_takes_two_seconds(bus_server: BusAddress, proof: Figures) -> None:
    def once() -> float:
        with Waits.watched() as waits:
            ramp = arm(bus_server, *LIGHT, "start_armed=false")
        if ramp.rising < RAMP_TICKS:
            raise TooLate(f"{ramp.rising} ticks in two seconds", (RAMP_TICKS - ramp.rising) * PERIOD_S, waits.seconds())
        return ramp.seconds

    proof.figure("arming: ramp of the stiffness", in_time(once), "s", limit="2 s")


def test_without_a_bus_the_loop_keeps_its_time(processes: None, tmp_path: Path, proof: Figures) -> None:
    def once() -> float:
        folder = Path(mkdtemp(dir=tmp_path))
        with Waits.watched() as waits:
            made, periods = take_the_bus_away(ServerOptions(folder=folder, socket=folder / "bus.sock"), *LIGHT)
        assert made < 1.1 * periods + 5
        if (missing := 0.7 * periods - made) >= 0:
            late_s = missing * PERIOD_S
            raise TooLate(f"the loop made {made:.0f} ticks, not {periods:.0f}", late_s, waits.seconds())
        return made / periods

    proof.figure("steps of the robot without a bus, of those that are due", 100 * in_time(once), "%", limit="70 %")
