"""A console is in nobody's way: what a robot is told is the same to the last bit, whatever becomes of a console."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from adapters.robots.g1 import twist_keys
from station.bus import keys
from station.bus.address import BusAddress
from station.episode.reading.reader import open_episode
from tests.main_job.station_runs import LOCK_STEP, Terminal, up
from tests.waiting import bus_answers, wait_until
from tests.web.console_process import ConsoleProcess, PageSocket

pytest.importorskip("starlette", reason="needs the extra 'console'")

ROBOT = twist_keys.TWIST2_ROBOT
MOTION = "motion.motion=builtin:walk-forward"


def _targets(folder: Path) -> list[bytes]:
    reader = open_episode(folder)
    return [message.data for message in reader.messages([keys.target(ROBOT)])]


def test_targets_are_bit_equal_with_consoles_that_are_killed(
    processes: None, tmp_path: Path, closing: Callable[[PageSocket], PageSocket]
) -> None:
    terminal = Terminal(tmp_path / "t")
    assert terminal.run(*up("alone", MOTION, *LOCK_STEP)).returncode == 0

    station = terminal.start(*up("watched", MOTION, *LOCK_STEP))
    address = BusAddress(socket=f"{terminal.environment['XDG_RUNTIME_DIR']}/station/bus.sock")
    wait_until(lambda: bus_answers(address) or station.poll() is not None)
    killed = 0
    while station.poll() is None:
        console = ConsoleProcess(address, tmp_path)
        page, view = closing(console.page()), closing(console.view())
        state = page.state(lambda state: state["robots"] or station.poll() is not None)
        if state["robots"] and station.poll() is None:
            view.say(want=[f"robot:{ROBOT}"])
            view.frame()
            killed += 1
        console.kill()
    output, _ = station.communicate(timeout=60)
    assert station.returncode == 0, output
    assert killed >= 2

    alone, watched = (_targets(terminal.episode(task)) for task in ("alone", "watched"))
    assert len(alone) > 100
    assert alone == watched
