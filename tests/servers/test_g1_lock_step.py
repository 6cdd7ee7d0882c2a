"""A G1 server in lock-step with its commander: a tick per command, and time that goes on without one."""

from __future__ import annotations

import pytest

from station import registry
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.contract import names_of
from station.control.rig import RigConfig
from station.control.tracking import TrackingError
from station.rehearse import rehearse_all
from tests.servers.g1_station import FORMAT, LIGHT, ROBOT, G1Process, Log, logged, motion_process, publish, ticks
from tests.waiting import wait_until

WALK = "builtin:walk-forward"


def test_in_lock_step_nothing_moves_before_the_first_command_and_then_once_per_command(bus_server: BusAddress) -> None:
    with (
        logged(bus_server) as log,
        G1Process(bus_server, *LIGHT, "pace=command", "command_timeout_s=3"),  # meanwhile time stands still
        Bus(bus_server, name="slow", timeout_s=5.0) as bus,
    ):
        wait_until(lambda: len(log.of(keys.robot_state(ROBOT))) > 2)
        assert ticks(log) == 0
        assert len(set(log.values(keys.sim_qpos(ROBOT)))) == 1
        for number in range(1, 60):
            publish(bus, FORMAT.default)
            wait_until(lambda number=number: ticks(log) >= number)  # type: ignore[misc]
        assert log.states()[50] == "tracking", "one second is fifty ticks, however long they take"
        wait_until(lambda: log.gate()["state"] == "waiting")  # and without commands time goes on by itself


def test_the_emergency_stop_is_heard_in_lock_step_while_no_command_comes(bus_server: BusAddress) -> None:
    with (
        logged(bus_server) as log,
        G1Process(bus_server, *LIGHT, "pace=command", "command_timeout_s=30"),
        Bus(bus_server, name="anna", timeout_s=5.0) as bus,
    ):
        wait_until(lambda: log.of(keys.robot_state(ROBOT)))
        publish(bus, FORMAT.default)
        wait_until(lambda: ticks(log) == 1)
        bus.publish({keys.ESTOP: b"1"})
        wait_until(lambda: log.gate()["state"] == "stopped")


def test_a_motion_through_the_lock_step_station_gives_the_figures_of_its_rehearsal(bus_server: BusAddress) -> None:
    (expected,) = rehearse_all([WALK], RigConfig(), jobs=1)
    with logged(bus_server) as log, G1Process(bus_server, "pace=command", "command_timeout_s=20"):
        wait_until(lambda: log.of(keys.robot_state(ROBOT)))
        with motion_process(bus_server, f"motion={WALK}", "pace=state", "patience_s=20") as motion:
            _, err = motion.communicate(timeout=100)
            assert motion.returncode == 0, err
    error = TrackingError(names_of(FORMAT.elements), registry.find("command", "twist2").joint_names)
    for state, used, qpos, source in _steps(log):
        if codec.parse_json(source)["phase"] == "playing":
            error.add(codec.parse_f64(state)[:29], codec.parse_f64(used), codec.parse_f64(qpos)[2])
    assert not log.events("fall")
    assert error.mean_joint_error_rad == pytest.approx(expected.mean_joint_error_rad, rel=1e-9)
    assert error.mean_root_height_error_m == pytest.approx(expected.mean_root_height_error_m, rel=1e-9)


def _steps(log: Log) -> list[tuple[bytes, bytes, bytes, bytes]]:
    """State, command used, ground truth and source of the command, of each policy step that tracked."""
    newest: dict[str, bytes] = {}
    steps = []
    for write in log.writes:
        if write.value is not None:
            newest[write.key] = write.value
        if write.key != keys.policy_timing(ROBOT):
            continue
        if codec.parse_json(newest[keys.command_gate(ROBOT)])["state"] == "tracking":
            steps.append((newest[keys.robot_state(ROBOT)], newest[keys.command_used(ROBOT)],
                          newest[keys.sim_qpos(ROBOT)], newest[keys.command_source(ROBOT)]))  # fmt: skip
    return steps
