"""Child processes of a station, with real servers: order, last words, and nobody left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from adapters.robots.g1 import twist_keys
from servers.motion import MotionConfig
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.errors import NotReady
from station.supervision.supervisor import Supervisor
from tests.waiting import DEADLINE_S, is_running, wait_until

WAVE = MotionConfig(motion="builtin:wave", loop=True, enter_s=0.1, leave_s=0.1)


@pytest.fixture
def bus(bus_server: BusAddress) -> Iterator[Bus]:
    """The supervisor's line."""
    with Bus(bus_server, name="supervisor", timeout_s=5.0) as line:
        yield line


@pytest.fixture
def supervisor(bus: Bus, tmp_path: Path) -> Iterator[Supervisor]:
    """Whose children are stopped at the end, whatever became of the test."""
    made = Supervisor(bus, tmp_path / "logs")
    try:
        yield made
    finally:
        made.stop_all()


def test_a_child_loads_and_stays_silent_until_it_is_activated(supervisor: Supervisor, bus: Bus) -> None:
    supervisor.spawn("motion", WAVE)
    health = supervisor.wait_for("motion", "inactive", DEADLINE_S)
    assert health.pid == supervisor.children["motion"].process.pid
    assert bus.get(twist_keys.action_body()) is None, "an inactive server commands nothing"
    supervisor.activate("motion")
    supervisor.wait_for("motion", "active", DEADLINE_S)
    wait_until(lambda: bus.get(twist_keys.action_body()) is not None)
    assert supervisor.stop("motion") == 0
    assert b'"finalized"' in (bus.get(keys.server("motion")) or b"")


def test_the_last_words_of_a_child_that_dies_are_in_the_error(supervisor: Supervisor) -> None:
    supervisor.spawn("motion", MotionConfig(motion="nowhere/walk.pkl"))
    with pytest.raises(NotReady, match=r"ended with code 2 while loading: .*nowhere/walk\.pkl"):
        supervisor.wait_for("motion", "inactive", DEADLINE_S)


def test_a_child_that_is_asked_to_stop_the_moment_it_is_started_need_not_be_killed(supervisor: Supervisor) -> None:
    supervisor.spawn("motion", WAVE)
    assert supervisor.stop("motion") in (0, -signal.SIGTERM)


def test_a_child_that_is_frozen_is_killed_when_it_is_stopped(supervisor: Supervisor) -> None:
    supervisor.spawn("motion", WAVE)
    supervisor.wait_for("motion", "inactive", DEADLINE_S)
    process = supervisor.children["motion"].process
    os.kill(process.pid, signal.SIGSTOP)
    assert supervisor.stop("motion", timeout_s=0.1) == -signal.SIGKILL
    assert not is_running(process.pid)
    assert "motion" not in supervisor.children


def test_a_child_that_does_not_get_ready_in_time_is_told_of(supervisor: Supervisor) -> None:
    supervisor.spawn("motion", WAVE)
    with pytest.raises(NotReady, match=r"is (inactive|unconfigured), not active"):
        supervisor.wait_for("motion", "active", 0.3)  # which nobody ever makes it


def test_a_child_that_does_not_do_what_it_is_asked_for_writes_to_its_log_where_it_stands(
    supervisor: Supervisor,
) -> None:
    supervisor.spawn("motion", WAVE)
    supervisor.wait_for("motion", "inactive", DEADLINE_S)
    with pytest.raises(NotReady, match=r"or see in its log /.*motion\.log where it stands"):
        supervisor.wait_for("motion", "active", 0.0)
    log = Path(supervisor.children["motion"].process.log)
    wait_until(lambda: ", line " in log.read_text() and "in ready" in log.read_text())
    assert supervisor.stop("motion") == 0, "it does what it did before"


_SUPERVISOR = """
import sys
from pathlib import Path
from servers.motion import MotionConfig
from station.bus import address
from station.bus.client import Bus
from station.supervision.supervisor import Supervisor

bus = Bus(address.parse(sys.argv[1]), name="supervisor", timeout_s=5.0)
supervisor = Supervisor(bus, Path(sys.argv[2]))
for name in ("active", "waiting"):
    config = MotionConfig(motion="builtin:wave", loop=True, format="twist2" if name == "active" else "twist")
    supervisor.spawn(name, config, server="motion")
    supervisor.wait_for(name, "inactive", 60)
supervisor.activate("active")
supervisor.wait_for("active", "active", 60)
print(*(child.process.pid for child in supervisor.children.values()), flush=True)
sys.stdin.read()
"""


def test_children_do_not_outlive_a_killed_supervisor_and_leave_cleanly(
    bus_server: BusAddress, bus: Bus, tmp_path: Path
) -> None:
    arguments = [sys.executable, "-c", _SUPERVISOR, bus_server.url, str(tmp_path / "logs")]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            pids = [int(word) for word in process.stdout.readline().split()]
        finally:
            process.kill()
    assert len(pids) == 2
    wait_until(lambda: not any(is_running(pid) for pid in pids))
    assert b'"finalized"' in (bus.get(keys.server("active")) or b""), "it must finish, not be cut down"


def test_a_second_server_of_the_same_name_is_refused(supervisor: Supervisor, bus_server: BusAddress) -> None:
    supervisor.spawn("motion", WAVE)
    pid = supervisor.wait_for("motion", "inactive", DEADLINE_S).pid
    command = [
        sys.executable,
        "-m",
        "station",
        "serve",
        "motion",
        "--bus",
        bus_server.url,
        "--set",
        "motion=builtin:wave",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=DEADLINE_S)
    assert done.returncode == 1
    assert f"server 'motion' is already running on {bus_server} (pid {pid} on " in done.stderr
    os.kill(pid, signal.SIGKILL)
    supervisor.stop("motion")
    supervisor.spawn("again", WAVE, server="motion")
    supervisor.wait_for("again", "inactive", DEADLINE_S)


def test_a_child_imports_nothing_from_the_folder_that_the_station_is_started_in(
    supervisor: Supervisor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "servers").mkdir()
    (tmp_path / "servers/__init__.py").touch()
    (tmp_path / "secrets.py").write_text("raise SystemExit('the secrets of this folder were imported')")
    monkeypatch.chdir(tmp_path)
    supervisor.spawn("motion", WAVE)
    supervisor.wait_for("motion", "inactive", DEADLINE_S)
