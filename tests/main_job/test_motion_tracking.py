"""Two stations that meet on motion_tracking's poses alone: one plays its pose server, the other its robot."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from station.episode.storage.manifest import load_manifest
from tests.main_job.station_runs import Terminal
from tests.main_job.test_lcm import in_the_background
from tests.servers.bridge_station import free_port
from tests.waiting import wait_until

pytestmark = pytest.mark.timeout(300)


def test_a_motion_of_one_station_walks_the_robot_of_another_by_poses(tmp_path: Path, processes: None) -> None:
    robots, devices = Terminal(tmp_path / "r"), Terminal(tmp_path / "d")
    ports = ("--set", f"poses.ports={json.dumps([free_port() for _ in range(3)])}")
    with in_the_background(robots, "up", "g1-motion-tracking", "--yes", "--record", "--task", "walk", *ports):
        # Who engages begins only on a robot that is there.
        wait_until(lambda: '"session"' in robots.run("status", "--json").stdout, 90.0)
        done = devices.run("up", "motion-tracking-robot", "--yes", *ports)
        assert done.returncode == 0, done.stdout + done.stderr
    episode = str(robots.episode("walk"))
    check, audit = robots.json("check", episode), robots.json("audit", episode)
    assert check["falls"] == 0
    walked = {stream["key"]: stream["count"] for stream in check["streams"]}["action_body_unitree_g1_with_hands"]
    assert walked > 200
    assert (audit["steps"] > 200, audit["different"]) == (True, 0)
    told = [event.name for event in load_manifest(Path(episode)).events if event.source == "poses"]
    assert told.count("motion-tracking-begun") == told.count("motion-tracking-ended") == 1
