"""A gamepad walks a G1, and a policy that tracks takes over and does a motion: recorded, audited."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adapters.robots.g1.joints import G1_29
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.protocols import Floats
from tests.main_job.station_runs import Terminal
from tests.waiting import wait_until

WALKED_M, MOVED_RAD = 0.1, 0.3
"""How far the sticks walk, and how far the hands then move a joint of the arms."""
ARMS = slice(7 + G1_29.index("left_shoulder_pitch"), None)
SETTINGS = ("gamepad.fake=builtin:gamepad/example.json", "motion.loop=true")

pytestmark = pytest.mark.timeout(300)


def test_both_drive_and_each_part_of_the_command_is_audited(proof: object, tmp_path: Path, processes: None) -> None:
    terminal, sets = Terminal(tmp_path), [word for setting in SETTINGS for word in ("--set", setting)]
    done = terminal.run("up", "g1-walk-track", "--yes", "--record", "--task", "bow", "--for", "15s", *sets)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "track drives" in done.stdout + done.stderr
    expect_both_drove(terminal, "bow")


@pytest.mark.parametrize("driver", ["hands", "body"])
def test_one_headset_walks_and_works_by_hand(driver: str, proof: object, tmp_path: Path, processes: None) -> None:
    terminal = Terminal(tmp_path)
    settings = ("pico.fake=builtin:pico/example.json", f"body.driver={driver}")
    sets = [word for setting in settings for word in ("--set", setting)]
    station = terminal.start("up", "g1-walk-track-pico", "--yes", "--record", "--task", "fetch", *sets)
    try:
        for line in station.stdout or ():
            if "part=walk from=entering to=tracking" in line:
                break
        with Bus(BusAddress(socket=f"{tmp_path}/station/bus.sock"), name="tests", timeout_s=5.0) as bus:
            wait_until(lambda: np.hypot(*pose(bus)[:2]) > WALKED_M)
            assert terminal.run("policy", "switch", "track").returncode == 0
            at = pose(bus)[ARMS]
            wait_until(lambda: np.abs(pose(bus)[ARMS] - at).max() > MOVED_RAD)
            assert terminal.run("policy", "switch", "g1-walks").returncode == 0
        assert terminal.run("down").returncode == 0
        station.communicate(timeout=60)
    finally:
        station.kill()
    expect_both_drove(terminal, "fetch")


def pose(bus: Bus) -> Floats:
    """Return place [m], orientation and joints [rad] of the robot, shape (36,)."""
    return codec.parse_f64(bus.get(keys.sim_qpos("g1_29")) or b"")


def expect_both_drove(terminal: Terminal, task: str) -> None:
    """Fail unless an episode is good, and what both policies did in it is derived again to the last bit."""
    episode = str(terminal.episode(task))
    check, audit = terminal.json("check", episode), terminal.json("audit", episode)
    assert (check["verdict"], check["falls"]) == ("good", 0), check["reasons"]
    assert [each["policy"] for each in (audit, *audit["took_over"])] == ["g1-walks", "g1-tracks"]
    assert {name: part["different"] for name, part in audit["parts"].items()} == {"walk": 0, "track": 0}
    differ = [audit[what]["different"] for what in ("observations", "commands", "targets")]
    assert (audit["different"], differ) == (0, [0, 0, 0])
    (robot,) = check["steps"]
    assert robot["mean_joint_error_rad"] < 0.06, "of the time in which the motion's policy drove"
