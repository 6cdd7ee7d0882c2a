"""Pilla's own ROS 2 nodes, unchanged, walk our Go2 for a minute: teleop and policy theirs, bridge and robot ours."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import station
from tests.dds_domains import domain
from tests.figures import Figures
from tests.lateness import TooLate, Waits, in_time
from tests.main_job.station_runs import Terminal
from tests.main_job.velocity_runs import Velocity
from tests.ros import Peer, peer, ros_python, stock
from tests.waiting import DEADLINE_S, wait_until

JOY = "sensor_msgs/msg/Joy"
STRETCH_S, SETTLED_AFTER_S = 10.0, 2.0
WITHIN = 0.1  # [m/s], [rad/s]
STICKS: dict[Velocity, tuple[float, float, int]] = {
    (0.0, 0.0, 0.0): (0.0, 0.0, 0),
    (0.5, 0.0, 0.0): (0.0, 1.0, 0),
    (0.0, 0.4, 0.0): (0.8, 0.0, 1),
    (0.0, 0.0, 0.5): (0.5, 0.0, 0),
    (-0.5, 0.0, 0.0): (0.0, -1.0, 0),
    (0.5, 0.0, 0.5): (0.5, 1.0, 0),
}
"""Axes 0 and 1 and button 4 of the joystick, by the velocity that Pilla's teleop node makes of them."""
_Y = 3  # button that engages


@contextlib.contextmanager
def nodes(assets: Path, folder: Path, ros_domain: int) -> Iterator[None]:
    """Run Pilla's policy and teleop nodes, with the policy where the first looks for it."""
    (folder / "pilla_rl_ros").mkdir(parents=True)
    shutil.copy(assets / "zoo/policies/pilla_go2_policy.jit", folder / "pilla_rl_ros/policy.jit")
    environment = os.environ | stock(assets) | {"ROS_DOMAIN_ID": str(ros_domain), "OMP_NUM_THREADS": "1"}
    started = []
    try:
        for name in ("rl_policy_node", "teleop_node"):
            with (folder / f"{name}.log").open("wb") as log:
                command = [ros_python(), str(assets / f"peers/pilla_rl_ros/{name}.py")]
                started.append(subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log))
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


def hold(node: Peer, sticks: tuple[float, float, int], *, pressed: int | None = None) -> None:
    """Hold the sticks of a joystick, and a button."""
    side, ahead, bumper = sticks
    buttons = [int(number == pressed) for number in range(11)]
    buttons[4] = bumper
    node.publish("/joy", JOY, axes=[side, ahead, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], buttons=buttons)


def minute(folder: Path, assets: Path) -> dict[Velocity, Velocity]:
    """Walk for a minute; return the velocities that were measured, by the commanded ones.

    Raises:
        TooLate: a command was held, since it came too late.
    """
    terminal = Terminal(folder / "t")
    words = ("up", "go2-pilla-policy", "--yes", "--record", "--task", "walk")
    with domain() as number, Waits.watched() as waits:
        sets = ("--set", f"bridge.python={ros_python()}", "--set", f"bridge.domain_id={number}")
        with nodes(assets, folder / "n", number), peer(number) as joystick:
            up = terminal.start(*words, *sets)
            try:
                wait_until(lambda: "Action #" in (folder / "n/rl_policy_node.log").read_text(), 2 * DEADLINE_S)
                hold(joystick, STICKS[0.0, 0.0, 0.0], pressed=_Y)
                wait_until(lambda: "Engaged" in (folder / "n/teleop_node.log").read_text())
                began = {}
                for asked, sticks in STICKS.items():
                    hold(joystick, sticks)
                    began[asked] = time.time_ns()
                    time.sleep(STRETCH_S)
            finally:
                up.terminate()
                said, _ = up.communicate(timeout=2 * DEADLINE_S)
    assert up.returncode in (0, -15, 143), said
    episode = station.open_episode(terminal.episode("walk"))
    events = [record.value for record in episode.events()]
    if held := [event for event in events if event["name"] == "gate" and event["detail"].get("to") == "holding"]:
        raise TooLate(f"commands were held {len(held)} times", 0.08, waits.seconds())
    assert "fall" not in {event["name"] for event in events}, said
    return measured(episode, began)


def measured(episode: station.Episode, began: dict[Velocity, int]) -> dict[Velocity, Velocity]:
    """Return the mean velocity in the robot's own heading of each stretch, once it has settled."""
    table = episode.numpy("sim_qpos_go2")
    times_s, rows = episode.wall_ns(table.written_s) * 1e-9, table.values
    w, x, y, z = rows[:, 3:7].T
    yaw = np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    found = {}
    for asked, ns in began.items():
        begin_s = ns * 1e-9 + SETTLED_AFTER_S
        one = (times_s >= begin_s) & (times_s < ns * 1e-9 + STRETCH_S)
        steps, seconds, heading = np.diff(rows[one, :2], axis=0), np.diff(times_s[one])[:, None], yaw[one][:-1]
        ahead, left = (steps / seconds).T
        forward = (ahead * np.cos(heading) + left * np.sin(heading)).mean()
        sideways = (left * np.cos(heading) - ahead * np.sin(heading)).mean()
        turned = (yaw[one][-1] - yaw[one][0]) / (times_s[one][-1] - times_s[one][0])
        found[asked] = (float(forward), float(sideways), float(turned))
    return found


@pytest.mark.assets
@pytest.mark.timeout(1200)
def test_pillas_own_nodes_walk_our_go2_for_a_minute_as_their_joystick_asks(
    tmp_path: Path, processes: None, assets: Path, proof: Figures
) -> None:
    ros_python()
    rounds = iter(range(100))
    found = in_time(lambda: minute(tmp_path / str(next(rounds)), assets))
    errors = {asked: float(np.abs(np.subtract(asked, came)).max()) for asked, came in found.items()}
    what = "Pilla's ROS 2 nodes, unchanged, walk the Go2 for a minute: farthest from the commanded velocity"
    proof.figure(what, max(errors.values()), limit=f"{WITHIN} m/s or rad/s")
    assert max(errors.values()) <= WITHIN, found
