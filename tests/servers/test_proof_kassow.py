"""The arm's server sends as often as it should, and begins nothing after a stop."""

from __future__ import annotations

from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import pytest

from station.bus import keys
from station.life import controller_request
from tests.figures import Figures
from tests.lateness import TooLate, Waits, in_time
from tests.servers.kassow_station import ROBOT, ArmStation, Commander, rate_hz, stop_and_release

SILENT_S = 0.25  # the gate takes 0.3 s without a command for an end of them


@pytest.mark.parametrize(("throttle", "most_hz"), [(2, 125.0), (4, 62.5)])
def test_targets_are_sent_at_the_rate_of_the_throttle(
    kord: Any, tmp_path: Path, processes: None, throttle: int, most_hz: float, proof: Figures
) -> None:
    def once() -> float:
        with ArmStation(Path(mkdtemp(dir=tmp_path))) as arm, Commander(arm):
            arm.wait_for_gate("tracking")
            controller_request.ask(arm.bus, ROBOT, "throttle", throttle=throttle)
            with Waits.watched() as waits:
                moving_hz = rate_hz(arm, "stream_j_sends", 1.5)
            assert arm.counter("fault_count") == 0
            assert arm.bus.get(keys.state_counters(ROBOT))
        assert moving_hz <= most_hz + 1.0
        if moving_hz < 0.8 * most_hz:
            raise TooLate(f"{moving_hz:.0f} targets a second", (0.8 - moving_hz / most_hz) * 1.5, waits.seconds())
        return moving_hz

    proof.figure(f"arm: targets sent in motion, throttle {throttle}", in_time(once), "Hz", limit=f"{most_hz:g} Hz")


def test_a_commander_that_goes_on_through_a_stop_is_not_followed(
    kord: Any, tmp_path: Path, processes: None, proof: Figures
) -> None:
    def once() -> None:
        with Waits.watched() as waits, ArmStation(Path(mkdtemp(dir=tmp_path))) as arm:
            released = stop_and_release(arm)
        if released.sent_hz > 0.0:
            assert released.gap_s > SILENT_S, f"{released.sent_hz:.0f} targets a second"
            raise TooLate("the commander", SILENT_S / 2, waits.longest_s)

    in_time(once)
