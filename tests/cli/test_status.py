"""``station status --watch``, beside a station that comes and goes."""

from __future__ import annotations

import json
import signal

import pytest

from tests.cli.at_terminal import AtTerminal
from tests.cli.running import COMMANDS_ONLY, Home, Running
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("processes")

LOOPED = ("up", COMMANDS_ONLY, "--set", "motion.loop=true")


def test_it_waits_for_a_station_and_goes_on_when_that_ends(home: Home) -> None:
    with home.running("status", "--watch", "--json") as watching:
        watching.wait_for("bus.sock: No such file or directory; does a station run there? `station up RUNBOOK` starts")
        with home.running(*LOOPED):
            wait_until(lambda: any(server["name"] == "motion" for server in json.loads(_line(watching))["servers"]))
            assert home.run("down").returncode == 0
        wait_until(lambda: sum("waiting for it" in line for line in watching.lines) == 2)
        assert watching.process.poll() is None
        watching.interrupt()
        assert watching.process.wait(60) == 0


def _line(watching: Running) -> str:
    assert watching.process.stdout is not None
    return watching.process.stdout.readline()


def test_on_a_screen_it_goes_on_as_well(home: Home) -> None:
    with AtTerminal(home, "status", "--watch") as watching:
        watching.wait_for("waiting for it; Ctrl-C ends")
        with home.running(*LOOPED):
            place = watching.wait_for("action_body_unitree_g1_with_hands")
            assert home.run("down").returncode == 0
        watching.wait_for("waiting for it; Ctrl-C ends", place)
        watching.send(signal.SIGINT)
        assert watching.finish() == 0
