"""The commands of `docs/hosts.md`, as they stand there, on two machines that are network namespaces."""

from __future__ import annotations

import os
import re
import shlex
import shutil
from contextlib import ExitStack
from pathlib import Path

import pytest

from station.bus import password_file
from tests.cli.running import Home, Running, new_home
from tests.docs.page import shown
from tests.network_link import machine
from tests.network_link.far_bus import ADDRESSES, opened_bus
from tests.network_link.link import Link
from tests.tiers import ROOT
from tests.waiting import wait_until

pytestmark = pytest.mark.timeout(180)


def test_the_commands_of_the_page_set_up_a_robot_and_its_operator(network_links: None, tmp_path: Path) -> None:
    commands = [shlex.split(each.command) for each in shown(ROOT / "docs" / "hosts.md")]
    copying = next(number for number, words in enumerate(commands) if words[0] == "scp")
    with Link(ADDRESSES) as link, ExitStack() as stack:
        robot = stack.enter_context(new_home(link.ends[0].prefix))
        operator = stack.enter_context(new_home((*link.ends[1].prefix, *machine.prefix(7200, "0badcafe"))))
        secret, copy = password_file.beside(Path(robot.bus.socket or "")), tmp_path / "station-password"

        def run(home: Home, words: list[str]) -> Running:
            assert words[0] == "station"
            running = stack.enter_context(home.running(*words[1:]))
            if words[1] == "serve":
                running.wait_for("is active")
            return running

        bus = run(robot, commands[0])
        opened_bus(robot)
        for words in commands[1:copying]:
            run(robot, words)
        assert secret.name == Path(commands[copying][1]).name
        shutil.copy2(secret, copy)
        for words in commands[copying + 1 :]:
            if words[0] == "export":
                settings = dict(word.split("=", 1) for word in words[1:])
                assert settings["STATION_BUS_PASSWORD_FILE"] == commands[copying][2]
                operator.environment |= settings | {"STATION_BUS_PASSWORD_FILE": os.fspath(copy)}
            elif words[1] == "serve":
                run(operator, words)
            else:
                wait_until(lambda words=words: _knows_both_clocks(operator.run(*words[1:]).stdout))
        assert bus.process.poll() is None


def _knows_both_clocks(said: str) -> bool:
    return len(re.findall(r"✓ clock of \S+: known to \d+\.\d ms", said)) == 2
