"""``station kassow``: clearing faults, choosing a profile, a controller apart, and five failures with their cures."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from station.cli.kassow import FAULTS
from station.view import fault_plot
from tests.cli.running import Home, one_line
from tests.servers.kassow_station import ArmStation, Commander
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")


@pytest.fixture(scope="module")
def arm(kord: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[ArmStation, Any]]:
    folder = tmp_path_factory.mktemp("arm")
    socket = folder / "controller.sock"
    with kord.ControllerServer(socket) as controller, ArmStation(folder, host=f"unix:{socket}") as station:
        yield station, controller


@pytest.fixture
def at_arm(arm: tuple[ArmStation, Any], home: Home) -> Home:
    """A terminal on the arm's bus."""
    home.environment["STATION_BUS"] = arm[0].server.address.url
    return home


def test_clear_takes_a_faulted_arm_back_and_says_what_to_do(arm: tuple[ArmStation, Any], at_arm: Home) -> None:
    station, controller = arm
    with Commander(station):
        station.wait_for_gate("tracking")
        controller.simulator.raise_event(1010)
        station.wait_for_gate("faulted")
    done = at_arm.run("kassow", "clear")
    assert done.returncode == 0, done.stderr
    assert "engage anew" in done.stdout
    station.wait_for_gate("waiting")


def test_doctor_names_a_fault_and_its_remedy(arm: tuple[ArmStation, Any], at_arm: Home) -> None:
    station, controller = arm
    controller.simulator.raise_event(3001)
    station.wait_for_gate("faulted")
    found = {item["subject"]: item for item in at_arm.json("doctor")}
    assert "3001" in found["gate"]["found"]
    assert "station kassow clear" in found["gate"]["remedy"]
    assert at_arm.run("kassow", "clear").returncode == 0


def test_a_profile_and_a_throttle_are_chosen_by_name_and_number(arm: tuple[ArmStation, Any], at_arm: Home) -> None:
    station, _ = arm
    assert at_arm.run("kassow", "profile", "time125").returncode == 0
    wait_until(lambda: station.controller()["profile"] == "time125")
    assert "speed125" in one_line(at_arm.run("kassow", "profile", "fast"))
    done = at_arm.run("kassow", "throttle", "4")
    assert "62.5" in done.stdout
    wait_until(lambda: station.controller()["throttle"] == 4)
    assert at_arm.run("kassow", "profile", "speed125").returncode == 0


def test_an_arm_that_nobody_serves_is_told_in_a_line(arm: tuple[ArmStation, Any], at_arm: Home) -> None:
    said = one_line(at_arm.run("kassow", "clear", "--robot", "kassow_kr1018"))
    assert "no server drives kassow_kr1018" in said
    assert "kassow_kr810" in said


def test_a_controller_apart_is_found_by_a_server_and_ends_on_ctrl_c(kord: Any, home: Home, tmp_path: Path) -> None:
    socket = tmp_path / "controller.sock"
    process = home.start("kassow", "controller", "--socket", str(socket))
    try:
        assert process.stdout is not None
        assert f"unix:{socket}" in process.stdout.readline()
        with ArmStation(tmp_path, host=f"unix:{socket}") as station:
            wait_until(lambda: station.controller()["connected"])
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
        assert not socket.exists()
    finally:
        process.kill()
        process.communicate()


def test_a_start_that_is_no_seven_numbers_is_refused(kord: Any, home: Home, tmp_path: Path) -> None:
    said = one_line(home.run("kassow", "controller", "--socket", str(tmp_path / "c.sock"), "--q-start", "0 0"))
    assert "controller" in said


def test_a_demonstration_draws_a_picture_and_prints_the_cure(kord: Any, home: Home, tmp_path: Path) -> None:
    picture = tmp_path / "fault.png"
    done = home.run("kassow", "demo-fault", "short-time", "--output", str(picture))
    assert done.returncode == 0, done.stderr
    assert "Cure: " in done.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert done.stderr == ""


@cache
def courses(name: str) -> Any:
    return demonstration(name).run()


def demonstration(name: str) -> Any:
    from station_kord import demonstrations

    return demonstrations.find(name)


def test_the_command_line_names_every_demonstration(kord: Any) -> None:
    from station_kord import demonstrations

    assert list(FAULTS) == demonstrations.names()


@pytest.mark.parametrize("name", FAULTS)
def test_every_demonstration_can_be_drawn(kord: Any, tmp_path: Path, name: str) -> None:
    faulty, cured = courses(name)
    path = fault_plot.save(demonstration(name), faulty, cured, tmp_path / "fault.png")
    assert len(path.read_bytes()) > 20_000


def test_reading_before_sending_faults_in_the_first_moments_and_sending_first_does_not(kord: Any) -> None:
    faulty, cured = courses("fetch-first")
    assert "1010" in faulty.event
    assert faulty.rows["late"].sum() == faulty.sends == 3
    assert (cured.event, int(cured.rows["late"].sum())) == ("", 0)


def test_stop_points_go_on_for_more_than_a_minute_and_via_points_do_not(kord: Any) -> None:
    faulty, cured = courses("stop-point")
    assert 98.0 <= faulty.rows["queued_motion_s"].max() <= 102.0
    assert faulty.still_moves_s > 90.0
    assert cured.rows["queued_motion_s"].max() <= 2.0, "one target's own time: nothing else differs"
    assert cured.still_moves_s <= 2.0


def test_targets_that_are_sent_again_and_again_fill_the_buffer_and_the_dirty_flag_sends_one(kord: Any) -> None:
    faulty, cured = courses("hold-flood")
    assert "3001" in faulty.event
    assert faulty.event_s is not None
    assert faulty.event_s - faulty.keys_s[0] == pytest.approx(2.98, abs=0.1)
    assert (cured.event, cured.sends) == ("", 1)


def test_targets_at_250_hz_come_faster_than_they_are_planned_and_at_125_hz_they_do_not(kord: Any) -> None:
    faulty, cured = courses("no-throttle")
    assert "3001" in faulty.event
    assert faulty.event_s is not None
    assert faulty.event_s - faulty.keys_s[0] == pytest.approx(1.8, abs=0.1)
    assert cured.event == ""
    assert cured.sends == pytest.approx(375, abs=2)


def test_too_short_a_time_ends_the_connection_and_steps_that_it_allows_do_not(kord: Any) -> None:
    faulty, cured = courses("short-time")
    assert "3002" in faulty.event
    assert cured.event == ""
    assert cured.rows["q"][-1, 0] - cured.rows["q"][0, 0] == pytest.approx(0.010, abs=1e-6)


def test_a_demonstration_without_the_bridge_says_how_to_build_it(tmp_path: Path) -> None:
    (tmp_path / "station_kord.py").write_text("raise ImportError('built for another Python')\n")
    done = subprocess.run(
        [sys.executable, "-m", "station", "kassow", "demo-fault", "short-time"],
        capture_output=True, text=True, env={"PYTHONPATH": str(tmp_path), "PATH": ""}, check=False,
    )  # fmt: skip
    assert re.search(r"pip install \./bridges/kord", one_line(done))
