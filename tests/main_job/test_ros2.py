"""ROS 2 walks a Go2 of the station: a velocity on /cmd_vel, our policy, and an episode of it."""

from __future__ import annotations

from pathlib import Path

import pytest

import station
from tests.dds_domains import domain
from tests.main_job.station_runs import Terminal
from tests.ros import peer, ros_python
from tests.waiting import DEADLINE_S


@pytest.mark.timeout(300)
def test_a_velocity_in_ros_walks_our_go2_and_its_joints_are_seen_there(tmp_path: Path, processes: None) -> None:
    python, terminal = ros_python(), Terminal(tmp_path / "t")
    words = ("up", "go2-ros2", "--yes", "--record", "--task", "walk", "--for", "9s")
    with domain() as number, peer(number) as node:
        node.listen("/joint_states", "sensor_msgs/msg/JointState")
        node.publish("/cmd_vel", "geometry_msgs/msg/Twist", linear={"x": 0.5})
        up = terminal.start(*words, "--set", f"bridge.python={python}", "--set", f"bridge.domain_id={number}")
        said, _ = up.communicate(timeout=2 * DEADLINE_S)
        seen = node.heard("/joint_states")
    assert up.returncode == 0, said
    folder = terminal.episode("walk")
    assert len(seen) > 100
    assert seen[-1]["name"][0] == "FL_hip"
    episode = station.open_episode(folder)
    place = episode.numpy("sim_qpos_go2", "root_x")
    assert place.values[-1, 0] - place.values[0, 0] > 1.0, "9 s at 0.5 m/s, less what starting takes"
    check, audit = terminal.json("check", str(folder)), terminal.json("audit", str(folder))
    assert (check["falls"], audit["different"], audit["commands"]["different"]) == (0, 0, 0)
    events = {event.value["name"] for event in episode.events()}
    assert "ros2-live" in events
    assert "ros2-row-unfit" in events, "the wheels have no tf2_msgs: the row is left out, and that is told"
