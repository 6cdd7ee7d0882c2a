"""The server that moves a simulated robot is killed and started again, while everything else goes on."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.episode.replaying.audit import audit
from tests.faults.moving_station import MovingStation

pytestmark = pytest.mark.usefixtures("processes")


def test_a_robots_server_that_is_killed_comes_back_standing_and_the_episode_holds_both_lives(tmp_path: Path) -> None:
    with MovingStation(tmp_path) as station:
        station.ask("start", task="lives")
        station.play("builtin:walk-forward")
        station.wait_s(1.0)
        station.kill("g1")
        since_ns = time.monotonic_ns()
        station.start_again("g1")
        station.wait_for_gate("tracking", since_ns)
        station.wait_s(1.0)
        gates = station.onlooker.gates(since_ns)
        assert gates.index("entering") < gates.index("tracking"), "it enters the motion that is being played"
        assert station.falls(since_ns) == 0
        folder = Path(station.ask("stop").path or "")
    writers = {step.writer for step in station.onlooker.steps}
    assert len(writers) == 2
    episode = open_episode(folder)
    quality, audited = check(episode), audit(episode)
    assert sum(stream.lost + stream.repeated for stream in quality.streams) == 0
    assert quality.falls == 0
    assert audited.steps > 100
    assert audited.different == audited.observations.different == 0, "each life is audited from its own beginning"
    assert audited.segments >= 2
