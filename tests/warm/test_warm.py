"""A child that is started warm ends as one that was started cold: its status, its last words, what it left to do."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from station import side_by_side
from tests.cli.running import COMMANDS_ONLY, new_home
from tests.warm import fork_server

pytestmark = pytest.mark.usefixtures("processes")

ENDS = {
    "nothing": "pass",
    "a number": "import sys; sys.exit(3)",
    "a number above a byte": "import sys; sys.exit(259)",
    "words": "import sys; sys.exit('no such robot')",
    "not flushed": "import sys; sys.stdout.write('a'); sys.stderr.write('b')",
    "left to do": "import atexit; atexit.register(print, 'closed')",
    "a thread": (
        "import threading; main = threading.main_thread();"
        "threading.Thread(target=lambda: (main.join(), print('done'))).start()"
    ),
    "exit within an exit": "import atexit, sys; atexit.register(print, 'closed'); sys.exit(5)",
    "interrupted": "raise KeyboardInterrupt",
    "killed": "import os, signal; os.kill(os.getpid(), signal.SIGKILL)",
    "asked to stop": "import os, signal; os.kill(os.getpid(), signal.SIGTERM)",
}
LAST_LINE_ONLY = ("interrupted",)  # above it a traceback, whose frames differ


def _ended(code: str, environment: dict[str, str] | None = None) -> tuple[int, bytes, list[bytes]]:
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], capture_output=True, check=False, env={**os.environ, **(environment or {})}
    )
    return done.returncode, done.stdout, done.stderr.splitlines()


@pytest.mark.parametrize("end", ENDS)
def test_a_warm_child_ends_as_a_cold_one(end: str) -> None:
    warm, cold = _ended(ENDS[end]), _ended(ENDS[end], {"PYTHONHASHSEED": "0"})
    if end in LAST_LINE_ONLY:
        warm, cold = (*warm[:2], warm[2][-1:]), (*cold[:2], cold[2][-1:])
    assert warm == cold


def test_output_that_finds_no_room_is_told_by_the_status() -> None:
    with Path("/dev/full").open("wb") as full:
        ends = [
            subprocess.run(
                [sys.executable, "-P", "-c", "print('words')"],
                stdout=full, stderr=subprocess.DEVNULL, check=False, env={**os.environ, **environment},
            ).returncode
            for environment in ({}, {"PYTHONHASHSEED": "0"})
        ]  # fmt: skip
    assert ends[0] == ends[1] != 0


def test_the_two_are_started_differently() -> None:
    code = "import sys; print('station.supervision.session' in sys.modules)"
    assert _ended(code)[1] == b"True\n"
    assert _ended(code, {"PYTHONHASHSEED": "0"})[1] == b"False\n"


def _who_shares_work(number: int) -> tuple[bool, str, bool]:
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    return "station.supervision.session" in sys.modules, os.environ["WHO_ASKS"], signal.SIGINT in blocked


@pytest.mark.parametrize("is_warm", [True, False])
def test_processes_that_share_work_are_started_warm_as_deaf_to_interrupts_as_cold_ones(
    is_warm: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WHO_ASKS", str(is_warm))
    if not is_warm:
        monkeypatch.setenv("PYTHONHASHSEED", "0")
    assert side_by_side.run(_who_shares_work, [1, 2], jobs=2) == 2 * [(is_warm, str(is_warm), True)]


def test_the_servers_of_a_station_are_started_warm_too() -> None:
    with new_home() as home, home.running("up", COMMANDS_ONLY, "--set", "motion.loop=true") as station:
        station.wait_for("· motion: motion-start")
        commands = [Path(f"/proc/{pid}/cmdline").read_bytes() for pid in home.pids().values()]
        station.interrupt()
        station.finish()
    assert commands
    assert all(fork_server.__file__.encode() in command for command in commands), commands
