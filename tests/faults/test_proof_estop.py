"""How soon an emergency stop damps the robot: with the next step, whichever process is dead."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np

from station.bus import keys
from station.bus.connection import Connection
from tests.faults.moving_station import MovingStation
from tests.faults.stops import Stop, stop_without_supervisor
from tests.figures import Figures
from tests.lateness import TooLate, Waits, in_time
from tests.waiting import wait_until

STOPS = 50


def test_no_step_after_the_one_under_way_has_stiffness(tmp_path: Path, processes: None, proof: Figures) -> None:
    after_ms = []
    with (
        MovingStation(tmp_path, record=False) as station,
        closing(Connection(station.address, timeout_s=5.0)) as line,
    ):
        station.play("builtin:walk-forward")
        for _ in range(STOPS):
            after_ms.append(in_time(lambda: stopped_after_s(station, line)) * 1e3)
        station.kill("motion")
        in_time(lambda: stopped_after_s(station, line))
    spread = f"{np.median(after_ms):.2g} / {np.percentile(after_ms, 99):.2g} / {max(after_ms):.2g}"
    proof.figure(f"stop by a stock client's `SET` to damped joints, p50 / p99 / max of {STOPS}", spread, "ms", "20 ms")


def stopped_after_s(station: MovingStation, line: Connection) -> float:
    """Stop the robot and release it; return how long it took [s]."""
    waits = Waits()
    stop = Stop(station.onlooker, line)
    stop.wait_until_damped()
    waited_s, late_s, after_s = waits.seconds(), stop.late_s(), stop.damped_after_s()
    line.call("SET", keys.ESTOP, b"0")
    wait_until(lambda: station.onlooker.steps[-1].gate in ("waiting", "tracking"))
    if late_s > 0.0:
        raise TooLate("the stop", late_s, waited_s)
    return after_s


def test_without_its_supervisor_the_robot_is_damped_at_once(processes: None, proof: Figures) -> None:
    def stop() -> None:
        with Waits.watched() as waits:
            stopped = stop_without_supervisor()
        if (late_s := stopped.late_s()) > 0.0:
            raise TooLate("the stop", late_s, waits.longest_s)

    in_time(stop)
