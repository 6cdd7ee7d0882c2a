"""What is logged, for a person or for a program; and variables that ask for what is not known."""

from __future__ import annotations

import json
from datetime import UTC, datetime

import pytest

from tests.cli.running import COMMANDS_ONLY, Home

pytestmark = pytest.mark.usefixtures("processes")


def test_a_program_reads_an_object_per_line_and_the_server_that_it_is_of(home: Home) -> None:
    home.environment["STATION_LOG_FORMAT"] = "json"
    with home.running("up", COMMANDS_ONLY, "--set", "motion.loop=true") as station:
        station.wait_for("· motion: motion-start")
        said = [json.loads(line) for line in home.run("logs", "--json", "motion").stdout.splitlines()]
        station.interrupt()
        station.finish()
    (started,) = [each for each in said if "motion-start" in each["message"]]
    assert started["server"] == "motion"
    assert (started["level"], started["logger"]) == ("info", "station.life.event_publisher")
    assert abs((datetime.now(UTC) - datetime.fromisoformat(started["time"])).total_seconds()) < 120
    assert isinstance(started["pid"], int)


def test_what_ended_a_server_is_told_in_plain_words_all_the_same(home: Home) -> None:
    home.environment["STATION_LOG_FORMAT"] = "json"
    done = home.run("serve", "motion", "--set", "motion=builtin:wave")
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("station: ")
    assert "does a station run there?" in done.stderr


def test_lines_that_are_no_objects_are_messages(home: Home) -> None:
    with home.running("up", COMMANDS_ONLY, "--set", "motion.loop=true") as station:
        station.wait_for("· motion: motion-start")
        said = [json.loads(line) for line in home.run("logs", "--json").stdout.splitlines()]
        station.interrupt()
        station.finish()
    assert {"motion"} <= {each["server"] for each in said}
    assert any(each["message"].startswith("I station.life.event_publisher: motion-start") for each in said)


@pytest.mark.parametrize(
    ("variable", "value", "told"),
    [
        ("STATION_LOG", "loud", "'loud'; expected info, debug, warning, error, critical; taken for info"),
        ("STATION_LOG_FORMAT", "xml", "'xml'; expected text, json; taken for text"),
    ],
)
def test_a_value_that_is_not_known_is_told_and_an_emergency_stop_goes_through(
    home: Home, variable: str, value: str, told: str
) -> None:
    home.environment[variable] = value
    with home.running("up", COMMANDS_ONLY, "--set", "motion.loop=true") as station:
        station.wait_for("· motion: motion-start")
        done = home.run("estop", "--reason", "test")
        station.interrupt()
        station.finish()
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines() == [f"W station: ${variable} is {told}"]


@pytest.mark.parametrize("level", ["DEBUG", "critical"])
def test_levels_in_either_case(home: Home, level: str) -> None:
    home.environment["STATION_LOG"] = level
    done = home.run("episodes", "list")
    assert (done.returncode, done.stderr) == (0, "")
