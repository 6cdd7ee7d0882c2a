"""The first contact with a G1 on its gantry, by the runbook of its twin (R21 to R24): measured, and kept."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("cyclonedds", reason="needs the extra 'g1'")

from adapters.robots.g1.dds.health_monitor import SILENT_S
from station.api.episode import open_episode
from tests.cli.running import Home, new_home
from tests.dds_domains import domain
from tests.figures import Figures
from tests.lateness import TooLate, Waits, in_time

pytestmark = pytest.mark.timeout(300)


@pytest.fixture
def hung(processes: None, real_time: None) -> Iterator[tuple[Home, list[str]]]:
    """A place, and the settings that give its twin a network of its own."""
    with new_home() as home, domain() as number:
        settings = (f"twin.options.domain={number}", f"robot.robot_options.domain={number}")
        yield home, [word for setting in settings for word in ("--set", setting)]


def measured(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the figures of an episode, by what was measured and by their names."""
    events = [record.value for record in open_episode(folder).events()]
    return {
        event["detail"]["what"]: {figure["name"]: figure for figure in event["detail"]["figures"]}
        for event in events
        if event["name"] == "measured"
    }


def on_time(trial: Callable[[], int]) -> int:
    """Have a station try something, and again where it went wrong while a process of it waited for a processor: what
    joints answer is measured in real time, of a robot that is simulated in real time."""

    def once() -> int:
        with Waits.watched() as waits:
            try:
                return trial()
            except AssertionError as error:
                raise TooLate(str(error), SILENT_S, waits.longest_s) from error

    return in_time(once)


def test_each_step_is_measured_and_what_came_of_it_stands_in_the_episode(
    hung: tuple[Home, list[str]], proof: Figures
) -> None:
    proof.figure("measures of the gantry's runbook that are as expected", on_time(lambda: measure_each_step(*hung)))


def measure_each_step(home: Home, sets: list[str]) -> int:
    done = home.run("up", "g1-twin-gantry", "--yes", "--record", "--task", "gantry", "--for", "100ms", *sets)
    assert done.returncode == 0, done.stderr
    folder = Path(done.stdout.strip())
    found = measured(folder)
    assert len(found) == 8
    assert all(figure["is_good"] for figures in found.values() for figure in figures.values())
    motors = found["what the motors do without commands"]["motors"]["numbers"]
    assert motors["do"] == "limp"
    assert list(found["what the motors do without commands"]["bits"]["numbers"]) == ["0x40000000"]
    led = found["each joint follows its own target, and no other does"]
    assert {"left_knee", "right_wrist_roll"} < set(led)
    manifest = open_episode(folder).manifest
    answers = {answer["step"]: answer for answer in manifest.runbook["answers"]}
    assert answers["ask: Move an arm by hand: is it limp?"]["answer"] == "not asked"
    assert answers["measure: it stands, and is pushed"]["answer"].startswith("rate: ")
    audited = home.json("audit", "latest")
    assert (audited["different"], audited["observations"]["different"], audited["targets"]["different"]) == (0, 0, 0)
    assert [each["policy"] for each in audited["took_over"]] == ["joint-by-joint", "default-pose", "tracker"]
    return len(found)


def test_a_joint_that_is_wired_wrong_ends_it_and_is_named(
    hung: tuple[Home, list[str]], tmp_path: Path, proof: Figures
) -> None:
    named = on_time(lambda: find_wrong_wires(*hung, tmp_path))
    proof.figure("joints on a gantry that are wired wrong, each named", named, "", "3 of 3")


def find_wrong_wires(home: Home, sets: list[str], tmp_path: Path) -> int:
    text = Path("runbooks/g1-twin-gantry.yaml").read_text()
    short = tmp_path / "short.yaml"
    begins, goes_on = (
        text.index('  - measure: "it hangs limp'),
        text.index("  - check: robot-ready", text.index("disarm:")),
    )
    short.write_text(text[:begins] + text[goes_on:])
    faults = ("twin.faults.reversed_joints=[left_knee]", "twin.faults.swapped_joints.left_elbow=right_elbow")
    wrong = [word for fault in faults for word in ("--set", fault)]
    done = home.run("up", str(short), "--yes", *sets, *wrong)
    assert done.returncode == 1, done.stderr
    (line,) = [line for line in done.stderr.splitlines() if "failed: " in line]
    assert "left_knee is not as expected (it alone follows): it moved the wrong way: " in line
    assert "; nor are left_elbow, right_elbow; " in line
    assert "right_elbow moved in its place: " in done.stderr
    return done.stderr.count("NOT as expected")
