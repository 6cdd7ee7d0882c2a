"""A stop that was pressed outlives Ctrl-C, the bus and its servers until somebody releases it."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.bus.client import Bus
from tests.cli.running import Home, one_line
from tests.cli.stopped import release
from tests.servers.g1_station import LIGHT
from tests.waiting import wait_until

BOOK = "runbook: t\nrobot: unitree_g1_with_hands\nsteps:\n  - start: g1\n    ready_within: 60s\n"
SETTINGS = [word for setting in LIGHT for word in ("--set", f"g1.{setting}")]


def test_a_stop_outlives_ctrl_c_and_every_command_says_so_until_it_is_released(home: Home, tmp_path: Path) -> None:
    book = tmp_path / "book.yaml"
    book.write_text(BOOK)
    with home.running("up", str(book), "--yes", *SETTINGS) as station:
        station.wait_for("✓ start g1")
        with Bus(home.bus, name="test", timeout_s=5.0) as bus:
            bus.call("SET", keys.ESTOP, b"1")  # by a stranger, of whom no file knows
        station.wait_for("to=stopped")
        station.interrupt()
        assert station.finish()[0] == 0
        assert "the emergency stop is latched since " in station.lines[-1]
    assert not home.bus_is_there()

    refused = one_line(home.run("up", str(book), "--yes", *SETTINGS))
    assert refused.startswith("the emergency stop is latched since ")
    assert refused.endswith("(emergency stop); release it with `station estop --reset`, then start again")
    assert one_line(home.run("demo")) == refused
    assert refused.removesuffix(", then start again") in one_line(home.run("status"))
    found = {item["subject"]: item for item in json.loads(home.run("doctor", "--json").stdout)}
    assert (found["e-stop"]["level"], found["e-stop"]["remedy"]) == ("broken", "station estop --reset")

    done = home.run("estop", "--reset")
    assert (done.returncode, done.stdout) == (0, "e-stop released; no bus runs\n")
    with home.running("up", str(book), "--yes", *SETTINGS) as station:
        station.wait_for("✓ start g1")
        wait_until(lambda: home.health()["g1"].detail.get("gate") == "waiting")
        station.interrupt()
        assert station.finish()[0] == 0


def test_a_robot_that_is_started_alone_starts_stopped_and_says_it_to_the_bus(home: Home) -> None:
    assert "NO robot was stopped" in one_line(home.run("estop", "--reason", "smoke"))
    with home.running("bus", "start") as bus:
        wait_until(home.bus_is_there)
        sets = [word for setting in LIGHT for word in ("--set", setting)]
        with home.running("serve", "g1", *sets) as robot:
            robot.wait_for("the emergency stop is latched since ")
            assert "release it with `station estop --reset`" in robot.text
            wait_until(lambda: home.health()["g1"].detail.get("gate") == "stopped")
            with Bus(home.bus, name="test", timeout_s=5.0) as line:
                wait_until(lambda: b"smoke" in (line.get(keys.ESTOP) or b""))
            assert "the emergency stop is latched since " in home.run("status").stdout
            assert json.loads(home.run("status", "--json").stdout)["stop"]["reason"].endswith(", smoke")
            refused = home.run("serve", "motion", "--set", "motion=builtin:wave")
            assert (refused.returncode, refused.stdout) == (1, "")
            assert refused.stderr.splitlines()[-1].startswith("station: the emergency stop is latched")
            release(home)
            with Bus(home.bus, name="test", timeout_s=5.0) as line:
                key = keys.command_gate(twist_keys.TWIST2_ROBOT)
                wait_until(lambda: codec.parse_json(line.get(key) or b"{}").get("state") == "waiting")
            os.kill(robot.process.pid, signal.SIGKILL)
        with home.running("serve", "g1", *sets):
            wait_until(lambda: home.health()["g1"].detail.get("gate") == "waiting")
        bus.interrupt()


def test_a_reset_where_nothing_is_latched_and_no_bus_runs_is_no_success(home: Home) -> None:
    assert "does a station run there? `station up RUNBOOK` starts one" in one_line(home.run("estop", "--reset"))
