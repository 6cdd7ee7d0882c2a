"""The server of a Kassow arm over the simulated controller: processes and a bus as a user has them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from servers.kassow import KassowConfig
from station.bus import codec, contracts, keys, robot_streams
from station.bus.address import BusAddress
from station.contract import TIMING_STAGES
from station.control.gate import GateConfig
from station.errors import Refused
from station.life import arm_request, controller_request
from station.life.events import Event, decode
from tests.servers.kassow_station import ROBOT, ArmStation, Commander, rate_hz, stop_and_release
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")

PATIENT = GateConfig(hold_after_s=1.0, return_after_s=3.0)
"""So long without a command counts as letting go: longer than a busy machine keeps a commander from writing."""
NEVER_LEFT = GateConfig(hold_after_s=20.0, return_after_s=60.0)
"""For a test in which nobody lets go."""


@pytest.fixture(scope="module")
def standing(kord: Any, processes: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ArmStation]:
    with ArmStation(tmp_path_factory.mktemp("arm")) as station:
        yield station


@pytest.fixture
def arm(standing: ArmStation) -> ArmStation:
    """An arm that stands and that nobody commands, whatever the test before it did."""
    standing.settle()
    return standing


def serve(address: BusAddress, *settings: str, **environment: str) -> subprocess.CompletedProcess[str]:
    sets = [word for setting in settings for word in ("--set", setting)]
    return subprocess.run(
        [sys.executable, "-m", "station", "serve", "kassow", "--bus", address.url, *sets],
        capture_output=True, text=True, timeout=60, env=os.environ | environment, check=False,
    )  # fmt: skip


def events(station: ArmStation, name: str) -> list[Event]:
    found = [decode(value) for value in station.log.values(keys.EVENT)]
    return [event for event in found if event is not None and event.name == name]


def test_a_server_without_the_bridge_says_in_a_line_how_to_build_it(bus_server: BusAddress, tmp_path: Path) -> None:
    (tmp_path / "station_kord.py").write_text("raise ImportError('built for another Python')\n")
    done = serve(bus_server, PYTHONPATH=str(tmp_path))
    assert done.returncode == 1
    assert "pip install ./bridges/kord" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


def test_a_model_whose_limits_nobody_has_given_is_refused(bus_server: BusAddress) -> None:
    done = serve(bus_server, "model=kr1018")
    assert done.returncode == 2
    assert "kr1018" in done.stderr.splitlines()[-1]
    assert "limits" in done.stderr.splitlines()[-1]


def test_limits_of_another_model_are_refused(bus_server: BusAddress) -> None:
    shipped = Path(__file__).parents[2] / "adapters/robots/kassow/kr810.yaml"
    done = serve(bus_server, "model=kr1410", f"limits={shipped}")
    assert done.returncode == 2
    assert "kr810" in done.stderr.splitlines()[-1]


def test_a_controller_that_is_not_there_is_told_in_a_line(kord: Any, bus_server: BusAddress, tmp_path: Path) -> None:
    done = serve(bus_server, f"host=unix:{tmp_path}/nobody.sock", "connect_within_s=0.3")
    assert done.returncode == 1
    assert "nobody.sock" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize("settings", [{"speed_rad_s": 0.0}, {"lead_s": 1.0}, {"model": "kr 810"}])
def test_settings_that_cannot_be_are_refused(settings: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="expected"):
        KassowConfig(**settings)


def test_every_value_is_as_its_contract_says(arm: ArmStation) -> None:
    for key in (keys.state_joints(ROBOT), keys.state_tcp(ROBOT), keys.state_counters(ROBOT), keys.target(ROBOT),
                keys.command_used(ROBOT)):  # fmt: skip
        contract = contracts.contract(key)
        assert contract is not None
        assert len(codec.parse_f64(arm.log.last(key))) == len(contract.elements), key
    assert len(codec.parse_json(arm.log.last(keys.policy_timing(ROBOT)))) == 2 + len(TIMING_STAGES)
    told = codec.parse_json(arm.log.last(keys.state_controller(ROBOT)))
    assert (told["backend"], told["profile"], told["throttle"]) == ("sim", "speed125", 2)


def test_the_tool_is_where_the_kinematics_of_the_model_say(arm: ArmStation) -> None:
    from adapters.robots.kassow import kinematics

    pose = codec.parse_f64(arm.log.last(keys.state_tcp(ROBOT)))
    expected = kinematics.chain("kr810").posture(arm.joints()).pose
    np.testing.assert_allclose(pose, [*expected.position, *expected.quat_wxyz], atol=1e-9)


def test_it_sends_half_of_the_ticks_in_motion_and_nothing_at_hold(kord: Any, processes: None, tmp_path: Path) -> None:
    with ArmStation(tmp_path, gate=NEVER_LEFT) as arm, Commander(arm) as commander:
        arm.wait_for_gate("tracking")
        moving_hz = rate_hz(arm, "stream_j_sends", 1.5)
        commander.moves = False
        wait_until(lambda: np.allclose(arm.joints(), commander.q, atol=1e-9))
        assert rate_hz(arm, "stream_j_sends", 0.5) == 0.0
        arm.wait_for_gate("tracking")
        assert 0.0 < moving_hz <= 126.0  # 125; a commander that a busy machine holds up has nothing new to send
        assert arm.counter("fault_count") == 0


def test_states_come_at_half_of_the_ticks_and_the_controllers_word_ten_times_a_second(arm: ArmStation) -> None:
    contract = contracts.contract(keys.state_joints(ROBOT))
    assert contract is not None
    assert contract.rate_hz == 125.0
    begun = len(arm.log.values(keys.command_used(ROBOT)))
    wait_until(lambda: len(arm.log.values(keys.command_used(ROBOT))) >= begun + 250)
    seen = Counter(write.key for write in list(arm.log.writes))
    assert seen[keys.state_joints(ROBOT)] == pytest.approx(seen[keys.command_used(ROBOT)] / 2, abs=2)


def test_silence_leaves_the_arm_where_it_is_and_who_returns_begins_from_there(arm: ArmStation) -> None:
    with Commander(arm):
        arm.wait_for_gate("tracking")
        rate_hz(arm, "stream_j_sends", 0.3)
    arm.wait_until_left_alone()
    at = arm.joints()
    with Commander(arm, moves=False):
        arm.wait_for_gate("tracking")
        np.testing.assert_allclose(arm.joints(), at, atol=1e-9)


def test_an_emergency_stop_stops_it_and_a_reset_waits_for_a_command_that_begins_anew(
    kord: Any, processes: None, tmp_path: Path
) -> None:
    with ArmStation(tmp_path, gate=PATIENT) as arm:
        assert stop_and_release(arm).sent_hz == 0.0


def test_disarming_lets_nothing_through_until_it_is_armed(arm: ArmStation) -> None:
    arm_request.ask(arm.bus, "disarm", name="kassow")
    with Commander(arm):
        wait_until(lambda: "disarmed" in arm.gate()["reason"])
        assert rate_hz(arm, "stream_j_sends", 0.3) == 0.0
    arm_request.ask(arm.bus, "arm", name="kassow")
    wait_until(lambda: "disarmed" not in arm.gate()["reason"])


SLOW_RAD_S = 0.05
"""So slow that no target is too far for its time where a busy machine sends it late: that would end the session."""


def test_a_profile_is_changed_at_standstill_only_and_stands_in_the_state(arm: ArmStation) -> None:
    def is_refused() -> bool:
        wait_until(lambda: arm.controller()["moving"])
        try:
            controller_request.ask(arm.bus, ROBOT, "profile", profile="time125")
        except Refused as refusal:
            return "standstill" in str(refusal)
        return False  # it stood: it turns every two seconds, and a busy machine may hold its commander up

    with Commander(arm, speed_rad_s=SLOW_RAD_S):
        arm.wait_for_gate("tracking")
        wait_until(is_refused)
    arm.wait_until_left_alone()
    controller_request.ask(arm.bus, ROBOT, "profile", profile="time125")
    wait_until(lambda: arm.controller()["profile"] == "time125")
    with Commander(arm, speed_rad_s=SLOW_RAD_S):
        arm.wait_for_gate("tracking")
        assert 0.0 < rate_hz(arm, "stream_j_sends", 0.5) <= 126.0
    arm.wait_until_left_alone()
    controller_request.ask(arm.bus, ROBOT, "profile", profile="speed125")


def test_an_unknown_profile_is_refused_with_those_that_there_are(arm: ArmStation) -> None:
    with pytest.raises(Refused, match="speed125"):
        controller_request.ask(arm.bus, ROBOT, "profile", profile="fast")


def test_a_throttle_holds_at_once_also_in_motion(arm: ArmStation) -> None:
    with Commander(arm):
        arm.wait_for_gate("tracking")
        controller_request.ask(arm.bus, ROBOT, "throttle", throttle=4)
        assert 0.0 < rate_hz(arm, "stream_j_sends", 1.0) <= 63.0
        controller_request.ask(arm.bus, ROBOT, "throttle", throttle=2)


def test_a_fault_disengages_is_told_and_is_left_by_clear_and_a_command_that_begins_anew(
    kord: Any, processes: None, tmp_path: Path
) -> None:
    socket = tmp_path / "controller.sock"
    with kord.ControllerServer(socket) as controller, ArmStation(tmp_path, host=f"unix:{socket}", gate=PATIENT) as arm:
        with Commander(arm):
            arm.wait_for_gate("tracking")
            controller.simulator.raise_event(1010)
            arm.wait_for_gate("faulted")
            assert "1010" in arm.gate()["reason"]
            arm_request.ask(arm.bus, "disarm", name="kassow")
            with pytest.raises(Refused, match="faulted"):
                arm_request.ask(arm.bus, "arm", name="kassow")
            controller_request.ask(arm.bus, ROBOT, "clear")
            wait_until(lambda: arm.gate()["state"] != "faulted")
            arm_request.ask(arm.bus, "arm", name="kassow")
            assert rate_hz(arm, "stream_j_sends", 0.5) == 0.0
        arm.settle()
        at = arm.joints()
        with Commander(arm, moves=False):
            arm.wait_for_gate("tracking")
        np.testing.assert_allclose(arm.joints(), at, atol=1e-6)
        wait_until(lambda: events(arm, "controller-cleared"))
        assert [event.detail["id"] for event in events(arm, "controller-event")].count(1010) == 1
        assert ["1010" in str(event.detail) for event in events(arm, "controller-fault")].count(True) == 1


def test_counters_have_a_name_each_in_the_state_of_the_bridge(kord: Any) -> None:
    assert not [name for name in robot_streams.COUNTERS if name not in kord.State.__slots__]
