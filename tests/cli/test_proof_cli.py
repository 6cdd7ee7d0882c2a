"""What the command line starts keeps its time: stops, rates, and a demo whose episode is good."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from adapters.robots.g1 import twist_keys
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from tests.cli.conftest import wave_once
from tests.cli.running import DEMO, Home, demo_episode, new_home, status_of_motion
from tests.cli.stopped import IN_TIME, driven_robot, stop_and_reset
from tests.figures import Figures
from tests.late_verdicts import expect_no_worse_in_time
from tests.lateness import TooLate, Waits, in_time

PERIOD_S = 0.02
SLOWEST_HZ = 45.0  # of a motion server, which is to write at 50
STOPS = 10


def test_a_stop_from_the_command_line_damps_within_a_step(processes: None, proof: Figures) -> None:
    def stop(home: Home) -> int:
        waits = Waits()
        before, said = stop_and_reset(home)
        assert said == (f"e-stop: {IN_TIME[0]}", IN_TIME[1])
        if before > 1:  # at most the step that was under way when the stop was written
            raise TooLate("the stop", (before - 1) * PERIOD_S, waits.seconds())
        return before

    with driven_robot() as (home, _):
        steps = [in_time(lambda: stop(home)) for _ in range(STOPS)]
    proof.figure(f"`station estop`: steps before the first that is damped, most of {STOPS}", max(steps), limit="1")


def test_status_says_the_rate_at_which_servers_write(live: Home, proof: Figures) -> None:
    def look() -> float:
        waits = Waits()
        motion, body = status_of_motion(live)
        slow_hz, fast_hz = sorted((motion["rate_hz"], body["rate_hz"]))
        assert fast_hz < 60
        if body["age_s"] >= 1:
            raise TooLate("the newest command", body["age_s"] - 1, waits.seconds())
        if slow_hz <= 40:
            raise TooLate(f"50 Hz are {slow_hz:.1f} Hz", 1 - slow_hz / 40, waits.seconds())  # of a look of a second
        return float(slow_hz)

    proof.figure("`station status`: rate of a motion server of 50 Hz", in_time(look), "Hz", limit="40 to 60 Hz")


def test_a_motion_server_writes_fifty_commands_a_second(processes: None, proof: Figures) -> None:
    def play() -> None:
        with new_home() as home, Waits.watched() as waits:
            made = wave_once(home)
            (body,) = (
                stream for stream in check(open_episode(made.episode)).streams if stream.key == twist_keys.action_body()
            )
        assert body.rate_hz is not None
        assert body.rate_hz < 55
        if body.rate_hz <= SLOWEST_HZ:
            late_s = (1 - body.rate_hz / SLOWEST_HZ) * body.count / SLOWEST_HZ
            raise TooLate(f"commands at {body.rate_hz:.1f} Hz", late_s, waits.seconds())
        assert body.count > 250
        assert body.longest_gap_s is not None
        proof.figure("motion server: rate in an episode", body.rate_hz, "Hz", limit="45 to 55 Hz")
        proof.figure("motion server: longest gap in an episode", body.longest_gap_s * 1e3, "ms")

    in_time(play)


def test_the_demo_leaves_a_good_episode(processes: None, proof: Figures) -> None:
    def run(home: Home) -> None:
        shutil.rmtree(home.data, ignore_errors=True)
        with Waits.watched() as waits:
            done = home.run(*DEMO)
        expect_no_worse_in_time("good", check(open_episode(demo_episode(home, done))), waits)
        assert ": good   " in done.stdout, done.stdout

    with new_home() as made:
        made.environment["PATH"] = f"{Path(sys.executable).parent}:{made.environment['PATH']}"
        in_time(lambda: run(made.without("STATION_ASSETS")))
