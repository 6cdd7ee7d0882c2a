"""Two stations that meet on SONIC's streams alone: one has the gamepad, the other the robot."""

from __future__ import annotations

from pathlib import Path

import pytest

from station.episode.storage.manifest import load_manifest
from tests.main_job.station_runs import Terminal
from tests.main_job.test_lcm import in_the_background
from tests.servers.bridge_station import free_port

pytestmark = pytest.mark.timeout(300)


def test_a_gamepad_of_one_station_walks_the_robot_of_another_by_sonics_planner(tmp_path: Path, processes: None) -> None:
    address, robots, devices = f"tcp://127.0.0.1:{free_port()}", Terminal(tmp_path / "r"), Terminal(tmp_path / "d")
    fakes = ("--set", "gamepad.fake=builtin:gamepad/example.json", "--set", f"sonic.address={address}")
    with in_the_background(devices, "up", "sonic-robot", "--yes", *fakes):
        words = ("--yes", "--record", "--task", "walk", "--for", "14s", "--set", f"sonic.address={address}")
        done = robots.run("up", "g1-sonic-commander", *words)
    assert done.returncode == 0, done.stdout + done.stderr
    episode = str(robots.episode("walk"))
    check, audit = robots.json("check", episode), robots.json("audit", episode)
    assert check["falls"] == 0
    walked = {stream["key"]: stream["count"] for stream in check["streams"]}["action_velocity_g1_29"]
    assert walked > 200
    assert (audit["steps"] > 200, audit["different"]) == (True, 0)
    assert {event.source for event in load_manifest(Path(episode)).events if event.name == "sonic-live"} == {"sonic"}
