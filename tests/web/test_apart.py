"""A console is in nobody's way: what a robot is told is the same to the last bit, whatever becomes of a console."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from adapters.robots.g1 import twist_keys
from station.bus import keys
from station.bus.address import BusAddress
from station.episode.reading.reader import open_episode
from tests.main_job.station_runs import LOCK_STEP, Terminal, up
from tests.web.conftest import StartConsole
from tests.web.console_process import PageSocket

pytest.importorskip("starlette", reason="needs the extra 'console'")

ROBOT = twist_keys.TWIST2_ROBOT
MOTION = "motion.motion=builtin:walk-forward"


def _targets(folder: Path) -> list[bytes]:
    reader = open_episode(folder)
    return [message.data for message in reader.messages([keys.target(ROBOT)])]


def _is_shown(view: PageSocket, station: subprocess.Popen[str]) -> bool:
    """Wait for a frame of the robot; none comes where the station has ended meanwhile."""
    view.say(want=[f"robot:{ROBOT}"])
    while station.poll() is None:
        with contextlib.suppress(TimeoutError):
            view.frame(0.2)
            return True
    return False


def test_targets_are_bit_equal_with_consoles_that_are_killed(
    start_console: StartConsole, bus_server: BusAddress, tmp_path: Path, closing: Callable[[PageSocket], PageSocket]
) -> None:
    terminal = Terminal(tmp_path / "t")
    assert terminal.run(*up("alone", MOTION, *LOCK_STEP)).returncode == 0

    console = start_console()  # before the robot, so that it sees it, however short the run is
    station = terminal.start(*up("watched", MOTION, *LOCK_STEP), "--bus", bus_server.url)
    killed = 0
    try:
        while station.poll() is None:
            page, view = closing(console.page()), closing(console.view())
            if page.state(lambda state: state["robots"] or station.poll() is not None)["robots"]:
                killed += _is_shown(view, station)
            console.kill()
            console = start_console()
        output, _ = station.communicate(timeout=60)
    finally:
        station.kill()
        station.wait()
    assert station.returncode == 0, output
    assert killed

    alone, watched = (_targets(terminal.episode(task)) for task in ("alone", "watched"))
    assert len(alone) > 100
    assert alone == watched
