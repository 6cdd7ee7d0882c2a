"""``station down`` and ``station logs``: a station is ended, and read, from another terminal."""

from __future__ import annotations

import pytest

from tests.cli.running import COMMANDS_ONLY, Home, are_gone, one_line
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")

LOOPED = ("up", COMMANDS_ONLY, "--set", "motion.loop=true")


def test_it_ends_a_station_in_order_and_waits_until_it_has(home: Home) -> None:
    with home.running(*LOOPED, "--record", "--task", "wave") as station:
        station.wait_for("· motion: motion-start")
        pids = list(home.pids().values())
        done = home.run("down")
        assert (done.returncode, done.stdout) == (0, "")
        assert done.stderr.startswith(f"ending the station with pid {station.process.pid}: motion, recorder\n")
        assert are_gone(pids)
        code, episode = station.finish()
        assert code == 0, station.text
    assert home.json("episodes", "show", episode.strip())["manifest"]["recorder"]["ended_by"] == "stop"
    again = home.run("down")
    assert (again.returncode, again.stdout) == (0, "")
    assert again.stderr.startswith("no `station up` of this machine runs on unix://")


def test_it_leaves_a_server_alone_that_was_started_by_hand(home: Home) -> None:
    with home.running("bus", "start") as bus:
        wait_until(home.bus_is_there)
        with home.running("serve", "motion", "--set", "motion=builtin:wave", "--set", "loop=true") as server:
            wait_until(lambda: "motion" in home.health())
            assert home.run("down").returncode == 0
            assert server.process.poll() is None
        assert bus.process.poll() is None


def test_of_two_stations_that_start_at_the_same_instant_one_runs_and_the_other_says_why_not(home: Home) -> None:
    with home.running(*LOOPED) as one, home.running(*LOOPED) as other:
        wait_until(lambda: None in (polls := [each.process.poll() for each in (one, other)]) and polls != [None, None])
        runs, refused = (one, other) if one.process.poll() is None else (other, one)
        assert refused.finish() == (1, "")
        assert "already runs on unix://" in refused.text
        assert f"(by `station up` with pid {runs.process.pid})" in refused.text
        assert len(refused.lines) == 1
        runs.wait_for("· motion: motion-start")
        assert home.run("down").returncode == 0
        assert runs.finish()[0] == 0


def test_the_logs_of_servers_are_printed_and_followed(home: Home) -> None:
    assert "no `station up` has run on that bus" in one_line(home.run("logs"))
    with home.running(*LOOPED) as station:
        station.wait_for("· motion: motion-start")
        last = home.run("logs", "-n", "1").stdout.splitlines()
        assert last[0].startswith("motion   | I station.life.event_publisher: motion-start")
        assert [line.split(" | ")[0] for line in last] in (["motion  "], ["motion  ", "recorder"])
        assert "unknown server's log 'moton' (did you mean 'motion'?)" in one_line(home.run("logs", "moton"))
        with home.running("logs", "--follow", "-n", "1", "motion") as following:
            assert (lines := following.process.stdout) is not None
            assert lines.readline().startswith("motion | I station.life.event_publisher: motion-start")  # it follows
            assert home.run("down").returncode == 0
            assert lines.readline().startswith("motion | I station.life.event_publisher: motion-end")
            following.interrupt()
            assert following.process.wait(60) == 0
