"""A controller in a process of its own: whatever becomes of the bridge's process, the arm comes to rest."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from station_kord import BadOption, ControllerServer, KordBridge, NotConnected, SimOptions

from tests.bridges.kord.arms import LIMITS, ONE_JOINT
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")

STANDSTILL_TICKS = 50
"""200 ms."""

TRIES = 5

DRIVER = """
import sys
from station_kord import KordBridge, Limits, SimOptions
path, mode = sys.argv[1:]
sim = SimOptions()
limits = Limits(q_min=sim.q_min, q_max=sim.q_max, qd_max=(2.0,) * 7, qdd_max=(10.0,) * 7)
bridge = KordBridge("unix:" + path, limits=limits, profile="legacy-stop" if mode == "stop-point" else "speed125")
bridge.connect()
if bridge.get_state().is_faulted:
    bridge.clear_faults()
q, tick = bridge.engage(), bridge.get_state().tick
if mode == "move":
    bridge.move_j(q + 1.0, speed_radps=0.2)
while True:
    state = bridge.get_state()
    if state.is_faulted:
        sys.exit("a fault")
    if state.tick == tick or mode == "move":
        continue
    q[0] += 0.0012 * (state.tick - tick)
    tick = state.tick
    if mode == "velocity":
        bridge.velocity_j([0.3] + [0.0] * 6)
    else:
        bridge.stream_j(q)
"""


@pytest.fixture
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ControllerServer]:
    # Commands that a busy machine delays are not what these tests are about; the watchdog is.
    options = SimOptions(torque_deviation_rad=1.0, late_fault_ticks=1_000_000)
    with ControllerServer(tmp_path_factory.mktemp("c") / "s", options) as controller:
        yield controller


@contextlib.contextmanager
def _driver(server: ControllerServer, mode: str) -> Iterator[subprocess.Popen[bytes]]:
    """Yield a process that drives the arm, under way; one that a busy machine stops before is followed by another."""

    def is_under_way() -> bool:
        row = server.simulator.trace(1)
        return bool(np.abs(row["qd"]).max(initial=0) > 0.05 or row["queued_motion_s"].max(initial=0) > 5.0)

    for _ in range(TRIES):
        driver = subprocess.Popen([sys.executable, "-c", DRIVER, str(server.path), mode], stderr=subprocess.DEVNULL)
        try:
            wait_until(lambda: driver.poll() is not None or is_under_way())  # noqa: B023
            if driver.poll() is None:
                yield driver
                return
        finally:
            driver.kill()
            driver.wait()
        wait_until(lambda: not server.has_client)
    raise AssertionError(f"no driver came under way in {TRIES} tries")


def _ticks_from_last_sign_of_life_to_rest(server: ControllerServer, begun: int) -> int:
    wait_until(lambda: not server.simulator.is_moving)
    rows = server.simulator.trace()
    moving = np.flatnonzero(np.any(rows["qd"] != 0.0, axis=1))
    return int(rows["tick"][moving[-1]]) + 1 - begun


@pytest.mark.parametrize("mode", ["stream", "velocity", "move", "stop-point"])
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "stopped"])
def test_a_bridge_that_dies_or_hangs_in_motion_leaves_an_arm_at_rest_within_200_ms(
    server: ControllerServer, mode: str, end: signal.Signals
) -> None:
    with _driver(server, mode) as driver:
        driver.send_signal(end)
        if end == signal.SIGSTOP:
            os.waitpid(driver.pid, os.WUNTRACED)
        else:
            driver.wait()
        begun = server.simulator.tick
        assert _ticks_from_last_sign_of_life_to_rest(server, begun) <= STANDSTILL_TICKS
    wait_until(lambda: not server.has_client)


def test_the_next_bridge_finds_the_arm_where_the_last_one_left_it(server: ControllerServer) -> None:
    with _driver(server, "move") as driver:
        driver.kill()
    wait_until(lambda: not server.has_client and not server.simulator.is_moving)
    with KordBridge(f"unix:{server.path}", limits=LIMITS) as bridge:
        state = bridge.connect()
        assert state.is_faulted, "motion without a bridge is a fault (3001)"
        assert np.all(state.q == server.simulator.trace(1)[0]["q"])
        bridge.clear_faults()
        q = bridge.engage() + 0.01 * ONE_JOINT
        bridge.stream_j(q)
        wait_until(lambda: abs(bridge.get_state().q[0] - q[0]) < 1e-9)


def test_a_second_bridge_is_refused_while_one_is_there(server: ControllerServer) -> None:
    host = f"unix:{server.path}"
    with KordBridge(host, limits=LIMITS) as first, KordBridge(host, limits=LIMITS) as second:
        first.connect()
        with pytest.raises(NotConnected):
            second.connect(3.0)
        tick = first.get_state().tick
        wait_until(lambda: first.get_state().tick > tick)


def test_a_controller_that_goes_is_a_lost_session_and_one_that_comes_back_is_found(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with ControllerServer(path) as server, KordBridge(f"unix:{path}", limits=LIMITS) as bridge:
        bridge.connect()
        bridge.engage()
        server.stop()
        wait_until(lambda: not bridge.get_state().is_connected)
        assert not bridge.get_state().is_engaged
        with pytest.raises(NotConnected):
            bridge.clear_faults(1.0)
        server.start()
        state = bridge.clear_faults()
        assert state.is_connected


def test_no_controller_is_said_in_words(tmp_path: Path) -> None:
    bridge = KordBridge(f"unix:{tmp_path}/none", limits=LIMITS)
    with pytest.raises(NotConnected, match="no controller answered at unix:"):
        bridge.connect(1.0)
    assert not bridge.get_state().is_connected


def test_a_socket_that_another_controller_listens_at_is_refused(server: ControllerServer) -> None:
    with pytest.raises(BadOption, match="another controller listens there"):
        ControllerServer(server.path).start()


def test_a_socket_that_nobody_listens_at_any_more_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with ControllerServer(path):
        left = path.stat().st_ino
    path.touch()
    with ControllerServer(path):
        assert path.is_socket()
        assert left


def test_a_controller_of_its_own_keeps_the_wall_clock(tmp_path: Path) -> None:
    with pytest.raises(BadOption, match="wall"):
        ControllerServer(tmp_path / "s", SimOptions(clock="virtual"))
