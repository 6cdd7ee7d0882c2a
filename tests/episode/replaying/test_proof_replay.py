"""A replay keeps the recorded times; what is late is not added up."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.bus.address import BusAddress
from station.episode.reading.reader import open_episode
from station.episode.replaying.replay import to_bus
from tests.episode.synthetic import EpisodeBuilder
from tests.figures import Figures
from tests.lateness import TooLate, Waits, in_time

WRITES, PERIOD_S = 500, 0.02
LATE_S = 0.25


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_a_replay_keeps_its_time_at_any_speed(
    bus_server: BusAddress, tmp_path: Path, speed: float, proof: Figures
) -> None:
    builder = EpisodeBuilder(tmp_path)
    for number in range(WRITES):
        builder.foreign("key", b"%d" % number, at_s=number * PERIOD_S)
    reader = open_episode(builder.finish())

    def once() -> float:
        with Waits.watched() as waits:
            report = to_bus(reader, bus_server, speed=speed)
        if report.lateness_max_s >= LATE_S:
            raise TooLate("a write", report.lateness_max_s - LATE_S, waits.longest_s)
        assert report.seconds == pytest.approx((WRITES - 1) * PERIOD_S / speed, abs=LATE_S)
        return report.lateness_p99_s

    p99_ms = in_time(once) * 1e3
    proof.figure(f"replay to a bus, speed {speed:g}: lateness of a write, p99", p99_ms, "ms", limit="250 ms at most")
