"""What scripts of users rely on: ``--json`` prints clean JSON of these shapes on stdout; all else goes to stderr."""

from __future__ import annotations

import json
from collections.abc import Iterator

import pytest

from adapters.robots.g1 import twist_keys
from station.bus.address import BusAddress
from tests.cli.conftest import Wave
from tests.cli.running import Home, new_home, row, status_of_motion
from tests.main_job.station_runs import LOCK_STEP
from tests.servers.g1_station import LIGHT
from tests.waiting import wait_until

SETTINGS = (*(f"g1.{setting}" for setting in LIGHT), "motion.motion=builtin:wave", "motion.enter_s=0.1",
            "motion.leave_s=0.1", *LOCK_STEP)  # fmt: skip


@pytest.fixture(scope="module")
def walked(processes: None) -> Iterator[tuple[Home, str]]:
    """A home with a short episode of a simulated robot, and the name of its folder."""
    sets = [word for setting in SETTINGS for word in ("--set", setting)]
    with new_home() as home:
        done = home.run("up", "g1-sim-motion", "--yes", "--record", "--task", "t", *sets)
        assert done.returncode == 0, done.stderr
        yield home, done.stdout.strip()


def test_status(live: Home) -> None:
    def is_writing() -> bool:
        """Whether it wrote while it was looked at, which a busy machine may keep it from."""
        motion, body = status_of_motion(live)
        assert body["age_s"] >= 0
        return bool(min(motion["rate_hz"], body["rate_hz"]) > 0)

    wait_until(is_writing)


def test_status_that_watches_prints_a_line_per_look(live: Home) -> None:
    with live.running("status", "--watch", "--json") as watching:
        assert watching.process.stdout is not None
        lines = [watching.process.stdout.readline() for _ in range(2)]
    assert all(lines), watching.text
    looks = [json.loads(line) for line in lines]
    assert all({server["name"] for server in look["servers"]} >= {"motion", "recorder"} for look in looks)


def test_status_of_a_bus_without_servers(bus_server: BusAddress, home: Home) -> None:
    home.environment["STATION_BUS"] = bus_server.url
    assert home.json("status")["servers"] == []
    assert home.run("status").stderr.startswith("no server has spoken on this bus")


@pytest.mark.parametrize("verb", [("check",), ("episodes", "check")])
def test_check(wave: Wave, verb: tuple[str, ...]) -> None:
    found = wave.home.json(*verb, str(wave.episode), "--no-write")
    assert found["verdict"] in ("good", "usable", "reject")
    shown = wave.home.json("episodes", "show", str(wave.episode))
    length_s = shown["manifest"]["timing"]["duration_s"]
    assert found["ends_s"] == [0.0, length_s], "an episode has one length"
    assert f" {length_s:.1f} s, " in wave.home.run(*verb, str(wave.episode), "--no-write").stdout.splitlines()[0]
    assert found["recorder_restarts"] == found["falls"] == 0
    body = row(found["streams"], key=twist_keys.action_body())
    assert body["lost"] == 0
    assert body["count"] > 10
    assert body["rate_hz"] > 0
    assert body["longest_gap_s"] > 0


def test_episodes_list_and_show(wave: Wave) -> None:
    listed = row(wave.home.json("episodes", "list"), episode_id=wave.episode.name)
    assert listed["state"] == "finished"
    assert listed["lost"] == 0
    assert listed["operator"] == "ada"
    assert wave.home.json("episodes", "list", "--task", "nothing") == []
    shown = wave.home.json("episodes", "show", "latest")
    assert shown["messages"] == listed["messages"]
    assert shown["manifest"]["episode_id"] == wave.episode.name


def test_bus_info(bus_home: Home) -> None:
    assert bus_home.json("bus", "info")["address"] == str(bus_home.bus)


def test_keys(home: Home) -> None:
    assert twist_keys.action_body() in [item["key"] for item in home.json("keys")]
    one = home.json("keys", twist_keys.action_body())
    assert len(one["elements"]) == 35


def test_an_error_leaves_stdout_empty(home: Home) -> None:
    for verb in (["status"], ["check", "latest"], ["episodes", "show", "latest"], ["record", "stop"], ["bus", "info"]):
        done = home.run(*verb, "--json")
        assert (done.returncode, done.stdout) == (2 if "check" in verb else 1, ""), verb


def test_audit(walked: tuple[Home, str]) -> None:
    home, episode = walked
    found = home.json("audit", episode)
    assert found["steps"] > 50
    assert (found["different"], found["max_abs_difference"]) == (0, 0.0)


def test_check_of_a_robot(walked: tuple[Home, str]) -> None:
    home, episode = walked
    found = home.json("check", episode)
    assert found["falls"] == 0
    assert found["steps"][0]["missing_steps"] == 0


def test_replay_to_a_simulation(walked: tuple[Home, str]) -> None:
    home, episode = walked
    assert home.json("replay", episode, "--to", "sim")["steps"] > 50


def test_replay_to_a_bus(walked: tuple[Home, str], bus_home: Home) -> None:
    _, episode = walked
    found = bus_home.json("replay", episode, "--to", "bus", "--speed", "4")
    assert found["is_complete"]
    assert found["lost"] == 0


def test_rehearse(walked: tuple[Home, str]) -> None:
    home, _ = walked
    done = home.run("rehearse", "builtin:wave", "--policy", "tracker", "--physics-dt", "0.002", "--json")
    (motion,) = json.loads(done.stdout)["motions"]
    assert motion["motion"] == "builtin:wave"
    assert set(motion) == {
        "motion", "fell", "fell_at_s", "mean_joint_error_rad", "mean_root_height_error_m", "velocity",
        "seconds", "speed_x_realtime",
    }  # fmt: skip
    assert done.returncode == (1 if motion["fell"] else 0)
    assert "1/1 builtin:wave" in done.stderr, "progress goes to stderr"
