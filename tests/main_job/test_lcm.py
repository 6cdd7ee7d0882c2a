"""Two stations that meet on LCM alone: one has the devices, the other the robot."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from station.episode.storage.manifest import load_manifest
from tests.adapters.lcm.test_multicast import free_port
from tests.main_job.station_runs import Terminal
from tests.waiting import DEADLINE_S

FAKES = (
    "gamepad.fake=builtin:gamepad/example.json",
    "left_leader.fake=builtin:gello/g1.json",
    "right_leader.fake=builtin:gello/g1-right.json",
)

pytestmark = pytest.mark.timeout(300)


@contextmanager
def in_the_background(terminal: Terminal, *words: str) -> Iterator[subprocess.Popen[str]]:
    process = terminal.start(*words)
    try:
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=2 * DEADLINE_S)


def test_a_gamepad_of_one_station_walks_the_robot_of_another_over_lcm(tmp_path: Path, processes: None) -> None:
    port, robots, devices = free_port(), Terminal(tmp_path / "r"), Terminal(tmp_path / "d")
    fakes = [word for setting in (*FAKES, f"homie.port={port}") for word in ("--set", setting)]
    with in_the_background(devices, "up", "homie-robot", "--yes", *fakes):
        words = ("--yes", "--record", "--task", "carry", "--for", "14s", "--set", f"cockpit.port={port}")
        done = robots.run("up", "g1-homie-cockpit", *words)
    assert done.returncode == 0, done.stdout + done.stderr
    episode = str(robots.episode("carry"))
    check, audit = robots.json("check", episode), robots.json("audit", episode)
    assert check["falls"] == 0
    walked = {stream["key"]: stream["count"] for stream in check["streams"]}["action_velocity_g1_29_legs"]
    assert walked > 200
    legs = audit["parts"]["legs"]
    assert (legs["compared"] > 200, legs["different"], audit["different"]) == (True, 0, 0)
    live = [event.source for event in load_manifest(Path(episode)).events if event.name == "lcm-live"]
    assert set(live) == {"cockpit"}
    assert len(live) <= 2, (
        "once for the pedals, and where a leader's script came near enough to its arm, once for those"
    )
