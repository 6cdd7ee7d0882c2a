"""The device and the driver of `docs/your-device.md`, as they stand there, drive the robot of `docs/your-robot.md`."""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path

import pytest

from station import Station
from station.bus.address import BusAddress, parse
from tests.main_job.page_package import install
from tests.main_job.station_runs import Terminal, begins_with_a_state
from tests.verdicts import OF_LATENESS
from tests.waiting import bus_answers, wait_until

PAGE, PACKAGE = "your-device.md", "pedal-lab"

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pedals")


@pytest.fixture(scope="module")
def driven(processes: None, place: Path) -> Terminal:
    """A terminal in which both packages are installed, and whose robot feet have driven, however long that took."""
    install("your-robot.md", "quad-lab", place)
    terminal = install(PAGE, PACKAGE, place)
    runbook = place / PACKAGE / "pedals.yaml"
    feet = ("--set", f"pedals.fake={place}/site/pedal_lab/pedals.json")
    with terminal.start("up", str(runbook), "--yes", "--record", "--task", "pedals", *feet) as up:
        try:
            wait_until(lambda: up.poll() is not None or bus_answers(bus(place)))
            with Station(bus(place).url) as lab:
                wait_until(lambda: element(lab, 0) > 0.1)
                wait_until(lambda: element(lab, 2) > 0.1)
        finally:
            up.send_signal(signal.SIGINT)
            said, _ = up.communicate(timeout=60)
            sys.stdout.write(said)  # shown where it failed
        assert up.returncode == 0
    return terminal


def bus(place: Path) -> BusAddress:
    return parse(f"unix://{place}/station/station/bus.sock")


def element(lab: Station, index: int) -> float:
    """One of vx, vy, wz of the command that the robot follows."""
    used = lab.read("command_used_quad")
    return float(used.vector()[index]) if used is not None else 0.0


def episode(terminal: Terminal) -> str:
    return str(terminal.episode("pedals"))


def test_its_episode_is_good_and_says_who_drove_with_what(driven: Terminal) -> None:
    found = driven.json("check", episode(driven))
    assert {reason["rule"] for reason in found["reasons"]} <= OF_LATENESS, found["reasons"]
    assert found["falls"] == 0
    servers = driven.json("episodes", "show", episode(driven))["manifest"]["servers"]
    assert servers["pedals"]["device"]["device"] == "pedals"
    assert servers["teleop"]["driver"]["options"]["forward_mps"] == 0.4
    assert servers["teleop"]["buttons"]["engage"] == "pedal_middle"


def test_what_the_robot_did_of_it_is_derived_again(driven: Terminal) -> None:
    audit = driven.json("audit", episode(driven))
    assert audit["steps"] > 100
    # Where a recording begins in the middle of a run, the state or the past of its first step may not be in the file.
    assert audit["segments"] == (1 if begins_with_a_state(audit) else 2)
    assert audit["steps"] - audit["observations"]["compared"] <= 1
    assert (audit["different"], audit["observations"]["different"]) == (0, 0)


def test_pedals_and_command_have_names(driven: Terminal, tmp_path: Path) -> None:
    done = driven.run("export", "lerobot", episode(driven), "--out", str(tmp_path / "set"))
    assert done.returncode == 0, done.stdout + done.stderr
    features = json.loads((tmp_path / "set" / "meta" / "info.json").read_text())["features"]
    assert features["action"]["names"] == ["vx", "vy", "wz"]
    drawn = tmp_path / "ep.rrd"
    assert driven.run("view", episode(driven), "--save", str(drawn)).returncode == 0
    assert drawn.stat().st_size > 50_000


def test_it_is_listed_and_its_fake_and_buttons_are_shown(driven: Terminal) -> None:
    assert "pedals" in [each["device"] for each in driven.json("devices", "list")]
    assert driven.json("devices", "buttons", "pedals")["pedals"]["engage"] == ["pedal_middle"]
    with driven.start("devices", "fake", "pedals") as fake:
        assert fake.stdout is not None
        lines = iter(fake.stdout.readline, "")
        assert any("pedal_left=1  pedal_middle=1" in line for line in lines)
        fake.send_signal(signal.SIGINT)


def test_without_the_pedals_one_line_says_what_to_do(driven: Terminal, place: Path) -> None:
    with driven.start("bus", "start") as server:
        try:
            wait_until(lambda: bus_answers(bus(place)))
            done = driven.run("serve", "pedals", "--set", "port=/dev/nowhere")
        finally:
            server.send_signal(signal.SIGINT)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].endswith(
        "pedals at /dev/nowhere: No such file or directory; plug them in, or name their port with port=…"
    )
