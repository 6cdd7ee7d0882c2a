"""An operator drives the simulated G1 through real processes: a fake headset under the real library, our own bus."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from servers.teleop import TeleopConfig
from station import config, registry
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.control.arming import RAMP_S
from station.control.rig import PolicyChoice
from station.errors import ConfigError
from station.life.events import Event
from station.life.server import Life
from station.life.stop_button import StopButton
from station.operator.buttons import HOLD_S
from station.operator.requests import ArmButtons, PolicyButton
from tests.servers.g1_station import ROBOT, logged
from tests.servers.operated_station import START_PAUSE, OperatedStation
from tests.servers.operated_trials import (
    SAME,
    X,
    be_silent_and_crash,
    is_of_the_device,
    record_and_begin_anew,
    wave_walk_and_leave,
)
from tests.verdicts import expect_no_worse_but_late
from tests.waiting import wait_until

A = START_PAUSE
EVERYTHING = [f"{side}_{what}" for side in ("left", "right") for what in ("trigger", "grip")]

pytestmark = [pytest.mark.timeout(240), pytest.mark.usefixtures("processes")]


def test_operator_waves_walks_lets_go_and_leaves(tmp_path: Path) -> None:
    driven = wave_walk_and_leave(tmp_path)
    assert driven.by_the_operator == ["engaged", "disengaged", "engaged", "mode", "disengaged", "exit"]


def test_silence_and_a_crash_let_go_until_a_new_press_and_a_long_absence_ends_the_commands(tmp_path: Path) -> None:
    told = [name for name, _ in be_silent_and_crash(tmp_path).told if name != "refused"]
    begun, ended = told[::2], told[1::2]  # a busy machine may add a pair anywhere, and a loss after the last beginning
    assert (set(begun), set(ended)) == ({"engaged"}, {"disengaged"})
    assert len(begun) >= 4


def refusals(station: OperatedStation) -> list[str]:
    """Return why nobody could begin to drive; among them that a sample came late, on a busy machine."""
    return [str(event.detail["reason"]) for event in station.told("operator-refused")]


def test_stop_button_latches_and_only_a_new_press_moves_the_robot_after_it(tmp_path: Path) -> None:
    with OperatedStation(tmp_path) as station:
        station.engage()
        station.press("left_stick_click", until=lambda: station.log.gate()["state"] == "stopped")
        assert "follows no more" in station.wait_for("teleop-commands-end").detail["reason"]
        station.press(A, until=lambda: "the emergency stop is latched" in refusals(station))
        count = len(station.commands())
        with StopButton(station.server.address, name="tests") as button:
            button.release("tests go on")
        station.wait_for_gate("waiting")
        assert len(station.commands()) == count
        station.drive_until(lambda: station.log.gate()["state"] == "tracking")
        assert station.restarts_at_engaging()[-1] <= SAME


def test_buttons_arm_and_disarm_a_robot_and_a_refusal_is_told_in_event_and_status_line(tmp_path: Path) -> None:
    def squeeze(station: OperatedStation, told: str) -> Event:
        station.press(*EVERYTHING, until=lambda: station.told(told), for_s=HOLD_S + 0.6)
        return station.told(told)[-1]

    with OperatedStation(tmp_path, start_armed=False) as station:
        station.press(A, until=lambda: "the robot is disarmed" in refusals(station))
        wait_until(lambda: "hold left_grip+left_trigger+right_grip+right_trigger to arm" in station.why_not())
        assert "button of pico" in squeeze(station, "arming").detail["who"]
        assert (station.wait_for("armed").wall_ns - station.told("arming")[0].wall_ns) * 1e-9 > 0.9 * RAMP_S
        station.drive_until(lambda: station.log.gate()["state"] == "tracking")
        disarm_while_driving(station)
        assert {reason for reason in station.reasons() if not is_of_the_device(reason)} == {"disarmed"}
        assert station.log.gate()["arming"] == "disarmed"
        station.press("left_stick_click", until=lambda: station.log.gate()["state"] == "stopped")
        refused = squeeze(station, "arm-refused")
        assert "the emergency stop is latched (" in refused.detail["reason"]
        wait_until(lambda: refused.detail["reason"] in station.why_not())
        assert not station.told("operator-arm-failed")
        assert max(station.restarts_at_engaging()) == 0.0


def disarm_while_driving(station: OperatedStation) -> None:
    """Disarm the robot while it is driven; again where a busy machine let go at that very moment."""
    while "disarmed" not in station.reasons():
        station.press(*EVERYTHING, until=lambda: station.log.gate()["arming"] == "armed", for_s=HOLD_S + 0.6)
        station.engage()
        station.press("left_menu", until=lambda: station.log.gate()["arming"] == "disarmed")
        wait_until(lambda: not station.is_engaged)


def test_an_arm_button_that_nobody_answers_is_told(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="teleop", timeout_s=5.0) as line, logged(bus_server) as log:
        life = Life(registry.find("server", "teleop"), "teleop", line, "")
        buttons = ArmButtons(life, ROBOT, "pico")
        buttons.press("arm")
        wait_until(lambda: log.events("operator-arm-failed"))
        wait_until(lambda: buttons.refusal.startswith("no low-level server runs on"))
        life.end("over")


def test_a_button_has_the_next_policy_take_over_and_the_next_the_first(tmp_path: Path) -> None:
    buttons = tmp_path / "buttons.yaml"
    buttons.write_text("rerecord: none\npolicy: hold right_secondary\n")
    stiff = PolicyChoice(policy="tracker", policy_options={"wrist_gains": "training"})
    with OperatedStation(tmp_path, policies={"stiff": stiff}, buttons=buttons) as station:
        for name in ("stiff", "tracker"):

            def drives(name: str = name) -> bool:
                return bool(station.log.gate()["policy"] == name)

            station.press("right_secondary", until=drives, for_s=HOLD_S + 0.6)
        assert [event.detail["policy"] for event in station.told("policy-switched")] == ["stiff", "tracker"]
        assert not station.told("operator-policy-failed")


def test_a_policy_button_that_cannot_do_it_says_why(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="teleop", timeout_s=5.0) as line, logged(bus_server) as log:
        life = Life(registry.find("server", "teleop"), "teleop", line, "")
        PolicyButton(life, ROBOT).press()
        wait_until(lambda: log.events("operator-policy-failed"))
        assert log.events("operator-policy-failed")[0].detail["reason"].startswith("no low-level server runs on")
        life.end("over")


def test_buttons_record_mark_and_begin_anew(tmp_path: Path) -> None:
    expect_no_worse_but_late("usable", record_and_begin_anew(tmp_path))


def test_facts_tell_what_the_buttons_mean(tmp_path: Path) -> None:
    with OperatedStation(tmp_path, driver="walk") as station:
        facts = codec.parse_json(station.log.last(keys.server_config("teleop")))
        assert facts["driver"]["driver"] == "walk"
        assert facts["buttons"]["start_pause"] == A
        assert facts["robot"] == ROBOT
        station.press(X, until=lambda: station.told("operator-exit"))
        assert station.wait_for_end() == 0
        assert station.commands() == []  # nobody has ever engaged


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"driver": "hand"}, "driver 'hand'"),
        ({"options": {"scael": 2.0}}, "did you mean 'scale'"),
        ({"options": {"scale": 9.0}}, "scale is 9; expected 0.1 to 3"),
        ({"device": "my-pico"}, "kind: nothing is known of the buttons of 'my-pico'"),
        ({"rate_hz": 5.0}, "rate_hz is 5; expected 20 to 500 Hz, or 0"),
        ({"patience_s": 0.1}, "patience_s is 0.1"),
        ({"driver": "body", "options": {"height_m": 17.5}}, "height_m is 17.5; expected 1 to 2.3 m"),
    ],
)
def test_wrong_setting_is_one_line_that_names_it(values: dict[str, Any], line: str) -> None:
    with pytest.raises(ConfigError) as caught:
        config.build(TeleopConfig, values, where="teleop")
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"device": "gello", "driver": "joints"}, "no control of a gello engages"),
        ({"driver": "body", "operator": "nobody-known"}, "no calibration of 'nobody-known'"),
        ({"buttons": "missing.yaml"}, "missing.yaml: no such file"),
    ],
)
def test_what_cannot_start_says_so_in_a_line(bus_server: BusAddress, values: dict[str, Any], line: str) -> None:
    from station.errors import StationError
    from station.life.serving import serve

    with pytest.raises(StationError) as caught:
        serve(registry.find("server", "teleop"), config.build(TeleopConfig, values, where="teleop"), address=bus_server)
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)
