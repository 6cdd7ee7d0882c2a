"""What is logged, for a person or for a program; and variables that ask for what is not there."""

from __future__ import annotations

import json
from datetime import UTC, datetime

import pytest

from tests.cli.running import COMMANDS_ONLY, Home, one_line

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


def test_what_ends_a_process_is_an_object_too(home: Home) -> None:
    home.environment["STATION_LOG_FORMAT"] = "json"
    done = home.run("serve", "motion", "--set", "motion=builtin:wave")
    assert done.returncode == 1
    (said,) = map(json.loads, done.stderr.splitlines())
    assert (said["level"], said["logger"]) == ("error", "station")
    assert "does a station run there?" in said["message"]


def test_lines_that_are_no_objects_are_messages(home: Home) -> None:
    with home.running("up", COMMANDS_ONLY, "--set", "motion.loop=true") as station:
        station.wait_for("· motion: motion-start")
        said = [json.loads(line) for line in home.run("logs", "--json").stdout.splitlines()]
        station.interrupt()
        station.finish()
    assert {"motion"} <= {each["server"] for each in said}
    assert any(each["message"].startswith("I station.life.event_publisher: motion-start") for each in said)


@pytest.mark.parametrize(
    ("variable", "value", "expected"),
    [("STATION_LOG", "loud", "debug, info, warning, error"), ("STATION_LOG_FORMAT", "xml", "text, json")],
)
def test_a_variable_that_asks_for_what_is_not_there(home: Home, variable: str, value: str, expected: str) -> None:
    home.environment[variable] = value
    done = home.run("episodes", "list")
    assert done.returncode == 2
    assert one_line(done) == f"${variable} is {value!r}; expected {expected}"


def test_a_level_is_taken_in_capitals_too(home: Home) -> None:
    home.environment["STATION_LOG"] = "DEBUG"
    assert home.run("episodes", "list").returncode == 0
