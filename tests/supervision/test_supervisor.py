"""Child processes of a station, with real servers: order, last words, and nobody left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from servers.motion import KIND as MOTION
from servers.motion import MotionConfig
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.errors import NotReady, Refused
from station.life.server import serve
from station.supervision.supervisor import Supervisor
from tests.adapters.motions import made
from tests.waiting import DEADLINE_S, wait_until


@pytest.fixture
def motion_file(tmp_path: Path) -> Path:
    from adapters.motions import npz_file
    from station.bus.joints import G1_29

    clip, path = made.smooth(frames=3000), tmp_path / "walk.npz"
    npz_file.save(
        path, fps=clip.fps, root_pos=clip.root_pos, root_quat_wxyz=clip.root_quat_wxyz, joint_pos=clip.q,
        joint_names=G1_29,
    )  # fmt: skip
    return path


def is_gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"


def test_a_child_loads_and_stays_silent_until_it_is_activated(
    bus_server: BusAddress, motion_file: Path, tmp_path: Path
) -> None:
    with Bus(bus_server, name="supervisor", timeout_s=5.0) as bus:
        supervisor = Supervisor(bus, tmp_path / "logs")
        try:
            supervisor.spawn("motion", MotionConfig(motion=str(motion_file)))
            health = supervisor.wait_for("motion", "inactive", DEADLINE_S)
            assert health.pid == supervisor.children["motion"].process.pid
            assert bus.get(keys.action_body()) is None, "an inactive server commands nothing"
            supervisor.activate("motion")
            supervisor.wait_for("motion", "active", DEADLINE_S)
            wait_until(lambda: bus.get(keys.action_body()) is not None)
            assert supervisor.stop("motion") == 0
        finally:
            supervisor.stop_all()
        assert b'"finalized"' in (bus.get(keys.server("motion")) or b"")


def test_the_last_words_of_a_child_that_dies_are_in_the_error(bus_server: BusAddress, tmp_path: Path) -> None:
    with Bus(bus_server, name="supervisor", timeout_s=5.0) as bus:
        supervisor = Supervisor(bus, tmp_path / "logs")
        try:
            supervisor.spawn("motion", MotionConfig(motion="nowhere/walk.pkl"))
            with pytest.raises(NotReady, match=r"ended with code 2 before it was inactive: .*nowhere/walk\.pkl"):
                supervisor.wait_for("motion", "inactive", DEADLINE_S)
        finally:
            supervisor.stop_all()


def test_a_child_that_does_not_get_ready_in_time_is_told_of(
    bus_server: BusAddress, motion_file: Path, tmp_path: Path
) -> None:
    with Bus(bus_server, name="supervisor", timeout_s=5.0) as bus:
        supervisor = Supervisor(bus, tmp_path / "logs")
        try:
            supervisor.spawn("motion", MotionConfig(motion=str(motion_file)))
            with pytest.raises(NotReady, match=r"is (inactive|unconfigured), not active"):
                supervisor.wait_for("motion", "active", 0.3)
        finally:
            supervisor.stop_all()


_SUPERVISOR = """
import sys, time
from pathlib import Path
from servers.motion import MotionConfig
from station.bus import address
from station.bus.client import Bus
from station.supervision.supervisor import Supervisor

bus = Bus(address.parse(sys.argv[1]), name="supervisor", timeout_s=5.0)
supervisor = Supervisor(bus, Path(sys.argv[3]))
for name in ("active", "waiting"):
    supervisor.spawn(name, MotionConfig(motion=sys.argv[2], format="twist2" if name == "active" else "twist"),
                     server="motion")
    supervisor.wait_for(name, "inactive", 60)
supervisor.activate("active")
supervisor.wait_for("active", "active", 60)
print(*(child.process.pid for child in supervisor.children.values()), flush=True)
time.sleep(600)
"""


def test_children_do_not_outlive_a_killed_supervisor_and_leave_cleanly(
    bus_server: BusAddress, motion_file: Path, tmp_path: Path
) -> None:
    arguments = [sys.executable, "-c", _SUPERVISOR, bus_server.url, str(motion_file), str(tmp_path / "logs")]
    with (
        subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as process,
        Bus(bus_server, name="t", timeout_s=5.0) as bus,
    ):
        assert process.stdout is not None
        pids = [int(word) for word in process.stdout.readline().split()]
        assert len(pids) == 2
        os.kill(process.pid, signal.SIGKILL)
        wait_until(lambda: all(is_gone(pid) for pid in pids))
        assert b'"finalized"' in (bus.get(keys.server("active")) or b""), "it must finish, not be cut down"


def test_a_second_server_of_the_same_name_is_refused(bus_server: BusAddress, motion_file: Path, tmp_path: Path) -> None:
    config = MotionConfig(motion=str(motion_file))
    with Bus(bus_server, name="supervisor", timeout_s=5.0) as bus:
        supervisor = Supervisor(bus, tmp_path / "logs")
        try:
            supervisor.spawn("motion", config)
            supervisor.wait_for("motion", "inactive", DEADLINE_S)
            with pytest.raises(Refused, match=r"'motion' is already running .* \(pid \d+"):
                serve(MOTION, config, address=bus_server)
            os.kill(supervisor.children["motion"].process.pid, signal.SIGKILL)
            supervisor.stop("motion")
            supervisor.spawn("again", config, server="motion")
            supervisor.wait_for("again", "inactive", DEADLINE_S)
        finally:
            supervisor.stop_all()
