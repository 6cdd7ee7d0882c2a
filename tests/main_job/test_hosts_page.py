"""The commands of `docs/hosts.md`, as they stand there, on three machines that are network namespaces."""

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
from tests.main_job.two_machines import AHEAD_S
from tests.network_link import machine
from tests.network_link.far_bus import ADDRESSES, opened_bus
from tests.network_link.link import Link
from tests.tiers import ROOT
from tests.waiting import wait_until

pytestmark = pytest.mark.timeout(180)

SAYS = {"host": " is active", "up": "✓ start motion"}
"""What a verb says that goes on until it is interrupted, once it does what it is for."""


def test_the_commands_of_the_page_set_up_a_robot_its_operator_and_a_recorder(
    network_links: None, tmp_path: Path
) -> None:
    commands = [shlex.split(each.command) for each in shown(ROOT / "docs" / "hosts.md")]
    assert len(commands) == 12
    of_robot, of_store, of_operator = commands[:2], commands[2:5], commands[5:]
    with Link(ADDRESSES) as link, ExitStack() as stack:
        robot = stack.enter_context(new_home(link.ends[0].prefix))
        others = zip(link.ends[1:], AHEAD_S.items(), strict=True)
        operator, store = (
            stack.enter_context(new_home((*end.prefix, *machine.prefix(ahead_s, boot))))
            for end, (boot, ahead_s) in others
        )
        running: dict[str, Running] = {}

        def run(home: Home, words: list[str]) -> None:
            assert words[0] == "station"
            if words[1:3] in (["bus", "start"], ["host", "join"]) or words[1] == "up":
                running[words[1]] = stack.enter_context(home.running(*words[1:]))
                if words[1] != "bus":
                    running[words[1]].wait_for(SAYS[words[1]])
            elif words[1] == "doctor":
                wait_until(lambda: _knows_all_clocks(home.run("doctor").stdout))
            else:
                if words[1] == "estop":
                    running["up"].wait_for("to=tracking")  # it may come while the robot is still entering
                done = home.run(*words[1:])
                assert done.returncode == 0, done.stderr

        run(robot, of_robot[0])
        opened_bus(robot)
        run(robot, of_robot[1])
        for number, (home, typed) in enumerate(((store, of_store), (operator, of_operator))):
            (_, source, copied), (_, *settings), *others_typed = typed
            secret = password_file.beside(Path(robot.bus.socket or ""))
            assert secret.name == Path(source).name
            copy = tmp_path / f"station-password-{number}"
            shutil.copy2(secret, copy)
            told = dict(word.split("=", 1) for word in settings)
            assert told["STATION_BUS_PASSWORD_FILE"] == copied
            home.environment |= told | {"STATION_BUS_PASSWORD_FILE": os.fspath(copy)}
            for words in others_typed:
                run(home, words)
        code, out = running["up"].finish()  # the last command is the emergency stop
        assert (code, out.strip()) == (1, f"store:{store.episode('carry')}"), running["up"].text
        assert "gate from=tracking to=stopped" in running["up"].text, running["up"].text


def _knows_all_clocks(said: str) -> bool:
    return len(re.findall(r"✓ clock of \S+: known to \d+\.\d ms", said)) == len(ADDRESSES)
