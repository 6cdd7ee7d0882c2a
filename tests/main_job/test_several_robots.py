"""A G1 and two arms of one kind on one bus, in one episode, with two operators."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from station import Station
from tests.cli.running import Home, new_home
from tests.waiting import wait_until

ARMS = ("kassow_kr810_left", "kassow_kr810_right")
PEOPLE = ("ada", "bob")
ROBOTS = (*ARMS, "unitree_g1_with_hands")

LONGEST_S = 150.0

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def together(processes: None, kord: Any) -> Iterator[Home]:
    """A place where each of the three was driven, recorded, however long that took."""
    names = [f"{side}_operator.operator={name}" for side, name in zip(("left", "right"), PEOPLE, strict=True)]
    settings = [word for setting in (*names, "motion.loop=true") for word in ("--set", setting)]
    with new_home() as home, home.running("bus", "start"):
        wait_until(home.bus_is_there)
        job = ("up", "g1-and-two-arms-sim", "--yes", "--record", "--task", "together", *settings)
        with home.running(*job) as station, Station(home.bus.url) as lab:
            driven: set[str] = set()

            def have_all_been_driven() -> bool:
                driven.update(robot.name for robot in lab.robots() if robot.gate == "tracking")
                return driven >= set(ROBOTS)

            wait_until(have_all_been_driven, LONGEST_S)
            station.wait_for("left_operator: operator-engaged")
            station.wait_for("right_operator: operator-engaged")
            station.interrupt()
            assert station.finish()[0] == 0, station.text
        yield home


def test_each_robot_was_driven_and_recorded_step_by_step(together: Home) -> None:
    found = together.json("check", str(together.episode("together")))
    assert (found["falls"], sum(stream["lost"] for stream in found["streams"])) == (0, 0)
    steps = {each["robot"]: each for each in found["steps"]}
    assert set(steps) == set(ROBOTS)
    for robot, each in steps.items():
        assert each["missing_steps"] == 0, robot
        assert each["gate_shares"]["tracking"] > 0.0, robot
    engaged = {writer for writer, event in events(together) if event["name"] == "operator-engaged"}
    assert engaged == {"left_operator", "right_operator"}


def events(terminal: Home) -> list[tuple[str, dict[str, Any]]]:
    shown = terminal.json("episodes", "show", "latest")["manifest"]["events"]
    return [(event["source"], event) for event in shown]


def test_what_each_did_is_derived_again(together: Home) -> None:
    found = {each["robot"]: each for each in together.json("audit", str(together.episode("together")))}
    assert set(found) == set(ROBOTS)
    for name in ARMS:
        arm = found[name]
        assert arm["targets"]["compared"] > 0, name
        assert (arm["commands"]["different"], arm["targets"]["different"], arm["states_different"]) == (0, 0, 0), name
    walker = found[ROBOTS[-1]]
    assert walker["steps"] > 0
    assert (walker["different"], walker["observations"]["different"]) == (0, 0)


def test_what_is_said_of_a_robot_stands_together(together: Home) -> None:
    said = together.run("check", str(together.episode("together"))).stdout
    parts = said.split("policy steps")[1:]
    assert len(parts) == len(ROBOTS)
    assert ["controller (sim" in part for part in parts] == [True, True, False]


def test_who_drove_which_arm_stands_in_its_configuration(together: Home) -> None:
    servers = together.json("episodes", "show", "latest")["manifest"]["servers"]
    operators = [facts for name, facts in servers.items() if name.endswith("_operator")]
    assert {each["robot"]: each["config"]["operator"] for each in operators} == dict(zip(ARMS, PEOPLE, strict=True))


def test_each_is_drawn_by_its_name_and_the_others_are_told(together: Home, tmp_path: Path) -> None:
    episode = str(together.episode("together"))
    for robot in ROBOTS:
        path = tmp_path / f"{robot}.png"
        done = together.run("view", episode, "--plot", str(path), "--robot", robot)
        assert done.stderr == f"shows {robot}; by --robot also {', '.join(sorted({*ROBOTS} - {robot}))}\n"
    plots = {(tmp_path / f"{robot}.png").read_bytes() for robot in ROBOTS}
    assert len(plots) == len(ROBOTS)
    refused = together.run("view", episode, "--plot", str(tmp_path / "left.png"), "--robot", "left")
    assert "no robot 'left' in it; it has kassow_kr810_left, kassow_kr810_right, unitree_g1" in refused.stderr
