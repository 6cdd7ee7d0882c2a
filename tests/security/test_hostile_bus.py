"""A bus on which somebody writes what nobody should: names that steer terminals, paths, endless and broken values."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.connection import Connection
from station.episode.quality.check import check
from station.episode.reading.reader import open_episode
from station.episode.recorder import remote
from station.episode.storage.request import RecordAnswer
from station.errors import Refused
from station.life.server import read_health
from station.printable import printable
from tests.waiting import wait_until

HOSTILE_KEYS = (
    b"two\nlines", b"nul\0within", b"\x1b[31mred\x1b[2J", b"\x1b]0;title\x07", b"\xff\xfe\x00binary", b"bell\x07\x08",
    "\u202eesrever".encode(), "\u2028line".encode(), b"[bold]markup[/]", b"[/nothing]", b"\xed\xa0\x80",
    b"k" * 4000, b"K" * 5000, b"%s%n{0}", b"../../../etc/passwd", b"station:recorder:stamps", b"policy_obs_\x1b[31m",
    b"policy_timing_../..", b"station:server:\x1b[31m", b"station:config:../../x", b"@", b"",
)  # fmt: skip
HOSTILE_VALUES = (
    b"", b"{", b"\xff" * 9, b"[" * 5000, b'{"a":' * 5000, b"9" * 5000, b"[1e999, NaN]", b'{"name": "\\ud800"}',
    b"null", b'"\\u001b[31m"', b'{"state": ["x"], "name": {"a": 1}, "robot": "\\u001b[2J", "role": "low-level"}',
)  # fmt: skip
OUR_KEYS = (
    keys.EVENT, keys.ESTOP, keys.RECORD, keys.RECORDER, keys.MOTION_CONTROL, keys.server("x"), keys.server_config("x"),
    keys.command_source("r"), keys.command_gate("r"), keys.policy_timing("r"), keys.robot_state("r"), "station:r@",
)  # fmt: skip
TASKS = (
    "../../outside", "/etc/outside", "..", ".", "", "a/b/c", "nul\0task", "line\nbreak", "\x1b[31m", "x" * 100_000,
    "\u202e\u2066", "\uff0e\uff0e\uff0f\uff0e\uff0e\uff0foutside", "CON", "-rf", "~root", "$(touch pwned)", "C:\\x",
    "K\u0130 \u212a", "\U0001f916",
)  # fmt: skip


@contextmanager
def _recorder(address: BusAddress, data: Path, *settings: str) -> Iterator[subprocess.Popen[bytes]]:
    log = (data.parent / "recorder.log").open("wb")
    arguments = [sys.executable, "-m", "station", "serve", "recorder", "--set", "min_free_mb=1"]
    arguments += [word for setting in settings for word in ("--set", setting)]
    environment = {**os.environ, "STATION_BUS": address.url, "STATION_DATA": str(data)}
    with log, subprocess.Popen(arguments, stdout=log, stderr=log, env=environment) as process:
        try:
            with Bus(address, name="waits", timeout_s=5.0) as bus:
                wait_until(lambda: any(health.state == "active" for health in read_health(bus)))
            yield process
        finally:
            process.kill()


def _ask(bus: Bus, action: str, **fields: object) -> RecordAnswer:
    return remote.ask(bus, action, timeout_s=30.0, **fields)  # type: ignore[arg-type]


def _station(address: BusAddress, *arguments: str) -> str:
    """Run a command; return all it printed, which must hold nothing that a terminal would obey."""
    environment = {**os.environ, "STATION_BUS": address.url, "COLUMNS": "100"}
    done = subprocess.run(
        [sys.executable, "-m", "station", *arguments], capture_output=True, env=environment, check=False, timeout=60
    )
    said = (done.stdout + done.stderr).decode()
    assert "Traceback" not in said, said[-2000:]
    assert not [char for char in said if not char.isprintable() and char != "\n"], said[-2000:]
    return said


@pytest.fixture
def data(tmp_path: Path) -> Path:
    folder = tmp_path / "data"
    folder.mkdir()
    return folder


def test_hostile_names_and_values_are_recorded_read_and_printed_without_harm(
    bus_server: BusAddress, data: Path
) -> None:
    with _recorder(bus_server, data) as recorder, Bus(bus_server, name="test", timeout_s=5.0) as bus:
        answer = _ask(bus, "start", task="hostile", instruction="\x1b[2J[bold]", operator={"id": "\x1b[31m[/x]"})
        line = Connection(bus_server, timeout_s=5.0)
        for key in HOSTILE_KEYS:
            for value in HOSTILE_VALUES[:3]:
                line.call("SET", key, value)
            line.call("MSET", key, b"1", key + b"@", b"1 2 3 \x1b[31m.1.x.y")
            line.call("MSET", key, b"1", key + b"@", b"1 99999999999999999999 3 a.1.x.y\n5 6")
        for name in OUR_KEYS:
            for value in HOSTILE_VALUES:
                line.call("SET", name, value)
        line.call("LPUSH", "a-list", "x")
        bus.publish({"native": b"1"})
        shown = _station(bus_server, "status")
        assert r"\x1b[31mred" in shown
        assert r"two\x0alines" in shown
        json.loads(_station(bus_server, "status", "--json").strip())
        _station(bus_server, "doctor")
        stopped = _ask(bus, "stop")
        assert stopped.episode_id == answer.episode_id
        assert recorder.poll() is None
        line.close()
    folder = Path(str(stopped.path))
    reader = open_episode(folder)
    assert reader.manifest.state == "finished"
    topics = reader.topics()
    assert {"two\nlines", "nul\0within", "native", "station:recorder:stamps", "\\xff\\xfe\0binary", "k" * 4000} <= set(
        topics
    )
    assert "K" * 5000 not in topics
    assert sum(1 for message in reader.messages(stamps=True) if message.stamp) > 0
    check(reader)
    for verb in (["check"], ["episodes", "show"]):
        _station(bus_server, *verb, str(folder))
    _station(bus_server, "episodes", "list", "--data", str(data))
    log = (data.parent / "recorder.log").read_text()
    assert "Traceback" not in log
    assert not [char for char in log if not char.isprintable() and char != "\n"]


def test_no_name_of_a_task_leads_out_of_the_data_folder(bus_server: BusAddress, data: Path) -> None:
    with _recorder(bus_server, data), Bus(bus_server, name="test", timeout_s=5.0) as bus:
        for task in TASKS:
            started = _ask(bus, "start", task=task)
            folder = Path(str(_ask(bus, "stop").path))
            assert started.path == str(folder)
            assert folder.parent.parent == data
            assert folder.resolve().is_relative_to(data.resolve())
            assert all(char.isascii() and (char.isalnum() or char == "-") for char in folder.name), folder.name
            assert len(folder.name) < 100
    assert sorted(path.name for path in data.parent.iterdir()) == ["data", "recorder.log"]
    assert len([path for path in data.rglob("manifest.yaml") if path.is_file()]) == len(TASKS)


def test_requests_that_no_manifest_could_hold_are_refused_with_a_reason(bus_server: BusAddress, data: Path) -> None:
    nest: dict[str, object] = {}
    for _ in range(100):
        nest = {"deeper": nest}
    with _recorder(bus_server, data), Bus(bus_server, name="test", timeout_s=5.0) as bus:
        for fields in ({"runbook": nest}, {"operator": {"id": "x", "list": [0] * 50_000}}, {"task": "x" * 2_000_000}):
            if "task" in fields:  # its answer has no address
                bus.publish({keys.RECORD: json.dumps({"id": "1", "action": "start", **fields}).encode()})
                continue
            with pytest.raises(Refused, match="not a record request"):
                _ask(bus, "start", **fields)
        assert _ask(bus, "start", task="fine").ok
        assert _ask(bus, "stop").ok


def test_a_value_that_is_too_large_for_the_recorder_is_dropped_and_counted(bus_server: BusAddress, data: Path) -> None:
    """The limits are 128 and 256 MB by default, here 1 MB."""
    with (
        _recorder(bus_server, data, "queue_mb=1", "preroll_mb=1") as recorder,
        Bus(bus_server, name="test", timeout_s=5.0) as bus,
        bus.watch(["large"]) as watch,
    ):
        bus.publish({"large": b"before"})
        _ask(bus, "start", task="large")
        bus.publish({"large": b"x" * 8_000_000})
        bus.publish({"large": b"after"})
        wait_until(lambda: (sample := watch.latest("large")) and sample.value == b"after")
        answer = _ask(bus, "stop")
        assert recorder.poll() is None
    assert answer.summary["dropped"] >= 1  # with what came in the same breath
    reader = open_episode(Path(str(answer.path)))
    assert max(len(message.data) for message in reader.messages()) < 1_000_000
    assert reader.manifest.recorder.dropped == answer.summary["dropped"]


def test_what_is_printed_of_strangers_steers_no_terminal() -> None:
    assert printable("a\x1b[31m\n\u202e\udcff\x9b") == r"a\x1b[31m\x0a\u202e\xff\x9b"
    assert printable("Grüße, 歩く") == "Grüße, 歩く"
    assert len(printable("x" * 10_000)) < 600
