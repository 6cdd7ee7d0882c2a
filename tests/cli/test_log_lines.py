"""What is logged, for a person or for a program; and variables that ask for what is not known."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from datetime import UTC, datetime

import pytest

from tests.cli.running import COMMANDS_ONLY, Home
from tests.main_job.station_runs import ROOT
from tests.waiting import DEADLINE_S, wait_until

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


class FullPipe:
    """Stands for a log whose disk stalls, or a terminal that Ctrl-S holds: who writes to it waits."""

    def __init__(self) -> None:
        self._end, self.descriptor = os.pipe()
        os.set_blocking(self.descriptor, False)
        self._filled = 0
        with contextlib.suppress(BlockingIOError):
            while True:
                self._filled += os.write(self.descriptor, b"." * 4096)
        os.set_blocking(self.descriptor, True)
        self._taken: list[bytes] = []
        self._reader = threading.Thread(target=self._take, daemon=True)

    def take(self) -> None:
        """Read everything from now on."""
        self._reader.start()

    def taken(self) -> list[bytes]:
        """Return what was read so far."""
        return list(self._taken)

    def lines(self) -> list[str]:
        """Return the lines that were written, when their writer has ended."""
        os.close(self.descriptor)
        self._reader.join(DEADLINE_S)
        return b"".join(self._taken)[self._filled :].decode().splitlines()

    def _take(self) -> None:
        with os.fdopen(self._end, "rb", buffering=0) as end:
            while some := end.read(65536):
                self._taken.append(some)


def test_a_server_waits_for_nobody_who_takes_its_log(bus_home: Home) -> None:
    pipe = FullPipe()
    motion = ("--name", "unheard", "--set", "motion=builtin:wave", "--set", "loop=true")
    words = [sys.executable, "-m", "station", "serve", "motion", *motion]
    server = subprocess.Popen(words, cwd=ROOT, env=bus_home.environment, stderr=pipe.descriptor)
    try:
        wait_until(lambda: (health := bus_home.health().get("unheard")) and health.rate_hz)  # its loop has run
        pipe.take()
        server.send_signal(signal.SIGTERM)
        assert server.wait(DEADLINE_S) == 0
    finally:
        server.kill()
        server.wait()
    said = pipe.lines()
    assert any("unheard is active on" in line for line in said), said


SAYS = """
import logging
from station.cli import log_lines
log_lines.begin()
with log_lines.never_waited_for():
    for number in range(3000):
        logging.warning("line %d", number)
    print("went on", flush=True)
    input()
    logging.warning("the last")
"""


@pytest.mark.parametrize("form", ["text", "json"])
def test_of_a_log_that_nobody_takes_a_thousand_lines_are_kept_and_told_how_many_more_there_were(form: str) -> None:
    pipe, environment = FullPipe(), {**os.environ, "STATION_LOG_FORMAT": form}
    with subprocess.Popen(
        [sys.executable, "-c", SAYS], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=pipe.descriptor, text=True,
    ) as process:  # fmt: skip
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stdout.readline() == "went on\n"
        pipe.take()
        wait_until(lambda: any(b"not kept" in some for some in pipe.taken()))
        process.stdin.write("\n")
        process.stdin.close()
        assert process.wait(DEADLINE_S) == 0
    *kept, told, last = pipe.lines()
    if form == "json":
        told = json.loads(told)["message"]
    (more,) = re.findall(r"(\d+) more lines were not kept: whoever takes this log was too slow", told)
    assert len(kept) in (1000, 1001), "one more is being written"
    assert int(more) + len(kept) == 3000
    assert "the last" in last


def test_a_server_that_ends_while_its_log_is_taken_again_tells_how_many_lines_it_did_not_keep() -> None:
    pipe, patient = (
        FullPipe(),
        SAYS.replace("log_lines.begin()", f"log_lines._LAST_S = {DEADLINE_S}; log_lines.begin()"),
    )
    with subprocess.Popen(
        [sys.executable, "-c", patient],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=pipe.descriptor,
        text=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stdout.readline() == "went on\n"
        process.stdin.write("\n")
        process.stdin.close()
        time.sleep(0.5)  # by then it waits for a place for its end
        pipe.take()
        assert process.wait(DEADLINE_S) == 0
    said = pipe.lines()
    more = [int(found[1]) for line in said if (found := re.search(r"(\d+) more lines were not kept", line))]
    assert more
    assert len(said) - len(more) + sum(more) == 3001, "and the last"


def test_a_log_that_nobody_takes_does_not_keep_a_server_from_its_end() -> None:
    pipe = FullPipe()
    done = subprocess.run(
        [sys.executable, "-c", SAYS], input="\n", stdout=subprocess.PIPE, stderr=pipe.descriptor, text=True,
        timeout=DEADLINE_S, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "went on\n")
    pipe.take()
    pipe.lines()
