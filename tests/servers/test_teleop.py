"""An operator drives the simulated G1 through real processes: a fake headset under the real library, our own bus."""

from __future__ import annotations

from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest

from servers.teleop import TeleopConfig
from station import config, registry
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.control.arming import RAMP_S
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.errors import ConfigError
from station.life.events import Event
from station.life.server import Life
from station.life.stop_button import StopButton
from station.operator.buttons import HOLD_S
from station.operator.requests import ArmButtons
from station.protocols import Floats
from tests.lateness import STALE_S, TooLate, Waits, in_time
from tests.servers.g1_station import ROBOT, logged
from tests.servers.operated_station import START_PAUSE, TIMEOUT_S, OperatedStation
from tests.verdicts import expect_no_worse
from tests.waiting import wait_until

FORM = registry.find("command", "twist2")
A, X, Y, B = START_PAUSE, "left_primary", "left_secondary", "right_secondary"
EVERYTHING = [f"{side}_{what}" for side in ("left", "right") for what in ("trigger", "grip")]
TOLD_OF_DRIVING = [f"operator-{what}" for what in ("engaged", "disengaged", "mode", "exit", "refused")]
SAME = 1e-6
ROUNDS = 3

pytestmark = pytest.mark.timeout(240)


def test_operator_waves_walks_lets_go_and_leaves(tmp_path: Path) -> None:
    in_time(lambda: wave_walk_and_leave(Path(mkdtemp(dir=tmp_path))), ROUNDS)


def wave_walk_and_leave(folder: Path) -> None:
    with Waits.watched() as waits, OperatedStation(folder) as station:
        assert station.log.gate()["state"] == "waiting"
        station.engage()
        station.wait_for_gate("tracking")
        station.let_go()
        station.drive_until(lambda: np.ptp(vectors(station)[:, 6:], axis=0).max() > 0.2)  # it waves
        station.press("right_stick_click", until=lambda: station.told("operator-mode"))
        station.worn.hold({"left_stick_y": 0.8})
        station.drive_until(lambda: vectors(station)[:, 0].max() > 0.3)  # and walks
        station.worn.let_go()
        station.let_go()
        station.press(X, until=lambda: station.told("operator-exit"))
        assert station.wait_for_end() == 0
        jumps = station.restarts_at_engaging()
        assert len(jumps) == len(station.told("operator-engaged"))
        assert max(jumps) <= SAME
        wait_until(lambda: np.abs(vectors(station)[-1] - FORM.default).max() <= SAME)  # the log may be a moment behind
        change = np.abs(np.diff(vectors(station), axis=0)) / (FORM.rate * 0.02)
        assert change.max() <= 1.0 + SAME
        assert station.is_upright()
        expect_told(station, waits, "engaged", "disengaged", "engaged", "mode", "disengaged", "exit")
        states = station.log.states()
        followed = states[states.index("tracking") :]
        assert set(followed) <= {"tracking", "holding", "returning", "waiting"}
        assert followed.count("tracking") > 0.8 * len(followed)


def expect_told(station: OperatedStation, waits: Waits, *names: str, losses: int = 0) -> None:
    """This was told of driving and nothing else; or the device fell silent more often than the test let it, because
    somebody had to wait."""
    found = [event.name.removeprefix("operator-") for event in station.told(*TOLD_OF_DRIVING)]
    silent = [reason for reason in station.reasons() if is_of_the_device(reason)]
    if found != list(names) and len(silent) > losses:
        waits.seconds()
        raise TooLate(f"{silent[-1]}: {found}", STALE_S / 2, waits.longest_s)
    assert found == list(names)


def is_of_the_device(reason: str) -> bool:
    """Whether driving ended because samples came late, as they do on a busy machine."""
    return "pico is " in reason or " jumped " in reason


def vectors(station: OperatedStation) -> Floats:
    """All commands so far, shape (n, 35)."""
    return np.array([vector for _, vector in station.commands()])


def test_silence_and_a_crash_let_go_until_a_new_press_and_a_long_absence_ends_the_commands(tmp_path: Path) -> None:
    in_time(lambda: be_silent_and_crash(Path(mkdtemp(dir=tmp_path))), ROUNDS)


def be_silent_and_crash(folder: Path) -> None:
    with Waits.watched() as waits, OperatedStation(folder, patience_s=2.0) as station:
        station.engage()
        station.wait_for_gate("tracking")
        station.worn.be_silent(1.0)
        station.wait_for("operator-disengaged")
        expect_nobody_drives(station)
        station.engage()
        died = len(station.told("server-restarted", "server-died"))
        station.worn.poison()
        wait_until(lambda: len(station.told("server-restarted", "server-died")) > died, TIMEOUT_S)
        expect_nobody_drives(station)  # the library took the server down with it, and it is there again
        station.engage()
        station.worn.be_silent(4.0)
        ended = station.wait_for("teleop-commands-end")
        assert "pico has been away" in ended.detail["reason"]
        station.wait_for_gate("waiting")
        expect_nobody_drives(station)
        station.engage()
        station.wait_for_gate("tracking")
        assert all("pico is" in reason for reason in station.reasons())
        jumps = station.restarts_at_engaging()
        assert max(jumps) <= SAME
        assert station.is_upright()
        expect_told(station, waits, *["engaged", "disengaged"] * 3, "engaged", losses=3)
        assert len(jumps) == 4


def expect_nobody_drives(station: OperatedStation) -> None:
    """The device is live again, and that alone moves nothing."""
    count = len(station.told("operator-engaged"))
    station.wait_until_live()
    assert len(station.told("operator-engaged")) == count
    assert not station.is_engaged


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
        station.engage()
        station.wait_for_gate("tracking")
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
        station.engage()
        station.wait_for_gate("tracking")
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


def test_buttons_record_mark_and_begin_anew(tmp_path: Path) -> None:
    in_time(lambda: record_and_begin_anew(Path(mkdtemp(dir=tmp_path))), ROUNDS)


def record_and_begin_anew(folder: Path) -> None:
    with Waits.watched() as waits, OperatedStation(folder, record=True, task="wave", operator="ada") as station:
        station.press(Y, until=lambda: station.told("record-start"))
        station.engage()
        station.press(B, until=lambda: station.told("mark"))
        station.press(B, until=lambda: len(station.told("record-start")) == 2, for_s=HOLD_S + 0.6)
        assert len(station.told("record-stop")) == 1
        marks = len(station.told("mark"))
        station.press(B, until=lambda: len(station.told("mark")) > marks)
        station.drive_until(lambda: station.log.gate()["state"] == "tracking")
        station.press(Y, until=lambda: len(station.told("record-stop")) == 2)
        assert not station.told("operator-record-refused")
        first, second = sorted((station.data / "wave").iterdir())
    assert check(open_episode(first)).discarded
    quality = check(open_episode(second))
    assert not quality.discarded
    expect_no_worse("usable", quality, waits)


def test_request_that_nobody_answers_is_told(tmp_path: Path) -> None:
    with OperatedStation(tmp_path) as station:
        station.press(Y, until=lambda: station.told("operator-record-refused"))
        assert "no recorder runs" in station.told("operator-record-refused")[0].detail["reason"]


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
