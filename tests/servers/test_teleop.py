"""An operator drives the simulated G1 through real processes: a fake headset under the real library, our own bus."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from servers.teleop import TeleopConfig
from station import config, registry
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.errors import ConfigError
from station.life.arming import RAMP_S
from station.life.server import Life
from station.life.stop_button import StopButton
from station.operator.buttons import HOLD_S
from station.operator.requests import ArmButtons
from tests.servers.g1_station import ROBOT, logged
from tests.servers.operated_station import OperatedStation
from tests.waiting import wait_until

FORM = registry.find("command", "twist2")
A, X, Y, B = "right_primary", "left_primary", "left_secondary", "right_secondary"
SAME = 1e-6

pytestmark = pytest.mark.timeout(240)


def press(at_s: float, control: str, for_s: float = 0.3) -> dict[str, Any]:
    return {"at_s": at_s, "press": control, "for_s": for_s}


def test_operator_waves_walks_lets_go_and_leaves(tmp_path: Path) -> None:
    walk = {"at_s": 9.0, "set": {"left_stick_y": 0.8}, "for_s": 3.0}
    controls = [
        press(2, A),
        press(5, A),
        press(6.5, A),
        press(8, "right_stick_click"),
        walk,
        press(13, A),
        press(16, X),
    ]
    with OperatedStation(tmp_path, controls) as station:
        assert station.log.gate()["state"] == "waiting"
        assert station.wait_for_end() == 0
        told = [event.name for event in station.told("operator-engaged", "operator-disengaged", "operator-mode",
                                                     "operator-exit", "operator-refused")]  # fmt: skip
        assert told == ["operator-engaged", "operator-disengaged", "operator-engaged", "operator-mode",
                        "operator-disengaged", "operator-exit"]  # fmt: skip
        jumps = station.restarts_at_engaging()
        assert len(jumps) == 2
        assert max(jumps) <= SAME
        vectors = np.array([vector for _, vector in station.commands()])
        assert np.ptp(vectors[:, 6:], axis=0).max() > 0.2  # it waved
        assert vectors[:, 0].max() > 0.3  # and walked
        assert np.abs(vectors[-1] - FORM.default).max() <= SAME
        change = np.abs(np.diff(vectors, axis=0)) / (FORM.rate * 0.02)
        assert change.max() <= 1.0 + SAME
        states = station.log.states()
        followed = states[states.index("tracking") :]
        assert set(followed) <= {"tracking", "holding", "returning", "waiting"}
        assert followed.count("tracking") > 0.8 * 50 * 12
        assert station.is_upright()


def test_silence_and_a_crash_let_go_until_a_new_press_and_a_long_absence_ends_the_commands(tmp_path: Path) -> None:
    faults = [
        {"at_s": 4.0, "kind": "silence", "for_s": 1.0},
        {"at_s": 9.0, "kind": "poison"},
        {"at_s": 18.0, "kind": "silence", "for_s": 4.0},
    ]
    controls = [press(2, A), press(7, A), press(16, A), press(25, A)]
    with OperatedStation(tmp_path, controls, faults, patience_s=2.0) as station:
        for count in (1, 2, 3):
            station.wait_for("operator-engaged", count)
            lost = station.wait_for("operator-disengaged", count)
            assert "pico is" in lost.detail["reason"]
        assert station.told("server-restarted", "server-died")  # the library took its process down
        ended = station.wait_for("teleop-commands-end")
        assert "pico has been away" in ended.detail["reason"]
        station.wait_for_gate("waiting")
        station.wait_for("operator-engaged", 4)
        station.wait_for_gate("tracking")
        jumps = station.restarts_at_engaging()
        assert len(jumps) == 4
        assert max(jumps) <= SAME
        assert station.is_upright()


def test_stop_button_latches_and_only_a_new_press_moves_the_robot_after_it(tmp_path: Path) -> None:
    controls = [press(2, A), press(5, "left_stick_click"), press(7, A), press(16, A)]
    with OperatedStation(tmp_path, controls) as station:
        station.wait_for("operator-engaged")
        station.wait_for_gate("stopped")
        assert "follows no more" in station.wait_for("teleop-commands-end").detail["reason"]
        refused = station.wait_for("operator-refused")
        assert refused.detail["reason"] == "the emergency stop is latched"
        count = len(station.commands())
        with StopButton(station.server.address, name="tests") as button:
            button.release("tests go on")
        station.wait_for_gate("waiting")
        assert len(station.commands()) == count
        station.wait_for("operator-engaged", 2)
        station.wait_for_gate("tracking")
        assert station.restarts_at_engaging()[-1] <= SAME


def test_buttons_arm_and_disarm_a_robot_and_a_refusal_is_told_in_event_and_status_line(tmp_path: Path) -> None:
    def squeeze(at_s: float) -> dict[str, Any]:
        every = {f"{side}_{what}": 1.0 for side in ("left", "right") for what in ("trigger", "grip")}
        return {"at_s": at_s, "set": every, "for_s": HOLD_S + 0.6}

    controls = [
        press(1, A),
        squeeze(3),
        press(9, A),
        press(13, "left_menu"),
        press(15, "left_stick_click"),
        squeeze(17),
    ]
    with OperatedStation(tmp_path, controls, start_armed=False) as station:
        assert station.wait_for("operator-refused").detail["reason"] == "the robot is disarmed"
        wait_until(lambda: "hold left_grip+left_trigger+right_grip+right_trigger to arm" in station.why_not())
        assert "button of pico" in station.wait_for("arming").detail["who"]
        assert (station.wait_for("armed").wall_ns - station.told("arming")[0].wall_ns) * 1e-9 > 0.9 * RAMP_S
        station.wait_for("operator-engaged")
        station.wait_for_gate("tracking")
        station.wait_for("disarmed")
        assert station.wait_for("operator-disengaged").detail["reason"] == "disarmed"
        assert station.log.gate()["arming"] == "disarmed"
        refused = station.wait_for("arm-refused")
        assert "the emergency stop is latched (" in refused.detail["reason"]
        wait_until(lambda: refused.detail["reason"] in station.why_not())
        assert not station.told("operator-arm-failed")
        assert station.restarts_at_engaging() == [0.0]


def test_an_arm_button_that_nobody_answers_is_told(bus_server: BusAddress) -> None:
    with Bus(bus_server, name="teleop") as line, logged(bus_server) as log:
        life = Life(registry.find("server", "teleop"), "teleop", line, "")
        buttons = ArmButtons(life, ROBOT, "pico")
        buttons.press("arm")
        wait_until(lambda: log.events("operator-arm-failed"))
        wait_until(lambda: buttons.refusal.startswith("no low-level server runs on"))
        life.end("over")


def test_buttons_record_mark_and_begin_anew(tmp_path: Path) -> None:
    controls = [press(2, Y), press(4, A), press(6, B), press(8, B, for_s=2.0), press(12, B), press(14, Y), press(17, X)]
    with OperatedStation(tmp_path, controls, record=True, task="wave", operator="ada") as station:
        assert station.wait_for_end() == 0
        wait_until(lambda: len(station.told("record-stop")) == 2)
        assert not station.told("operator-record-refused")
        first, second = sorted((station.data / "wave").iterdir())
        assert check(open_episode(first)).discarded
        quality = check(open_episode(second))
        assert quality.verdict != "reject", quality.reasons
        assert not quality.discarded


def test_request_that_nobody_answers_is_told(tmp_path: Path) -> None:
    with OperatedStation(tmp_path, [press(1, Y)]) as station:
        refused = station.wait_for("operator-record-refused")
        assert "no recorder runs" in refused.detail["reason"]


def test_facts_tell_what_the_buttons_mean(tmp_path: Path) -> None:
    with OperatedStation(tmp_path, [press(1, X)], driver="walk") as station:
        facts = codec.parse_json(station.log.last(keys.server_config("teleop")))
        assert facts["driver"]["driver"] == "walk"
        assert facts["buttons"]["start_pause"] == A
        assert facts["robot"] == ROBOT
        assert station.wait_for_end() == 0
        assert station.commands() == []  # nobody has ever engaged


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"driver": "hand"}, "driver 'hand'"),
        ({"options": {"scael": 2.0}}, "did you mean 'scale'"),
        ({"options": {"scale": 9.0}}, "scale is 9; expected 0.1 to 3"),
        ({"device": "my-pico"}, "kind: nothing is known of the buttons of 'my-pico'"),
        ({"rate_hz": 5.0}, "rate_hz is 5; expected 20 to 200 Hz"),
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
    from station.life.server import serve

    with pytest.raises(StationError) as caught:
        serve(registry.find("server", "teleop"), config.build(TeleopConfig, values, where="teleop"), address=bus_server)
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)
