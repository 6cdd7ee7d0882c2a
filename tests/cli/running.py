"""``station …`` as a user runs it: real processes, in a terminal that meets no station of anybody else."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from adapters.robots.g1 import twist_keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.life.server import Health, read_health
from tests.main_job.station_runs import LOCK_STEP, ROOT, Terminal
from tests.waiting import DEADLINE_S, bus_answers, is_running, wait_until

COMMANDS_ONLY = "commands-only"
SHORT = ("--set", "motion.enter_s=0.1", "--set", "motion.leave_s=0.1")
"""Blends as short as they may be: tests of the command line wait for no robot."""
DEMO = ("demo", "--for", "3s", *SHORT)
IN_STEP = tuple(word for setting in LOCK_STEP for word in ("--set", setting))
"""Robot and motion wait for each other: nothing of an episode is late, however busy the machine is."""


class Running:
    """A verb that runs; its stderr is gathered line by line, and in a file that the report of a failure shows."""

    def __init__(self, terminal: Terminal, *arguments: str) -> None:
        self._file = Path(terminal.environment["XDG_RUNTIME_DIR"]) / f"{arguments[0]}.stderr"
        self.process = subprocess.Popen(
            [*terminal.prefix, sys.executable, "-m", "station", *arguments],
            cwd=ROOT, env=terminal.environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        self.lines: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def text(self) -> str:
        return "\n".join(self.lines)

    def wait_for(self, text: str) -> None:
        """Wait until a line holds a text; fail when the process ends before."""

        def is_there() -> bool:
            found = any(text in line for line in list(self.lines))
            if not found and self.process.poll() is not None:
                self._reader.join()
                assert any(text in line for line in self.lines), f"no {text!r} in:\n{self.text}"
            return found

        wait_until(is_there, DEADLINE_S)

    def wait_until(self, condition: Callable[[], object], timeout_s: float = DEADLINE_S) -> None:
        """Wait until a condition holds; fail when the process ends before."""
        wait_until(lambda: condition() or self.process.poll() is not None, timeout_s)
        assert condition(), f"ended with {self.process.returncode} before it held:\n{self.text}"

    def interrupt(self) -> None:
        self.process.send_signal(signal.SIGINT)

    def finish(self, timeout_s: float = 60.0) -> tuple[int, str]:
        """Wait for the end; return exit code and stdout."""
        assert self.process.stdout is not None
        out = self.process.stdout.read()
        code = self.process.wait(timeout_s)
        self._reader.join()
        return code, out

    def close(self) -> None:
        self.process.kill()
        self.finish()
        for stream in (self.process.stdout, self.process.stderr):
            if stream is not None:
                stream.close()

    def _read(self) -> None:
        assert self.process.stderr is not None
        with self._file.open("a") as file:
            for line in self.process.stderr:
                self.lines.append(line.rstrip("\n"))
                file.write(line)
                file.flush()


class Home(Terminal):
    """A terminal with a place of its own, and what lives there."""

    @property
    def bus(self) -> BusAddress:
        return BusAddress(socket=str(Path(self.environment["XDG_RUNTIME_DIR"]) / "station" / "bus.sock"))

    def bus_is_there(self) -> bool:
        return bus_answers(self.bus)

    @contextmanager
    def running(self, *arguments: str) -> Iterator[Running]:
        """Run a verb in the background; killed at the end if it still runs."""
        running = Running(self, *arguments)
        try:
            yield running
        finally:
            running.close()

    def health(self) -> dict[str, Health]:
        with Bus(self.bus, name="test", timeout_s=5.0) as line:
            return {health.name: health for health in read_health(line)}

    def pids(self) -> dict[str, int]:
        """Process ids of the servers that run and said no farewell, by name, however late their heartbeats are."""
        heard = {name: health for name, health in self.health().items() if health.state != "finalized"}
        return {name: health.pid for name, health in heard.items() if is_running(health.pid)}

    def without(self, *variables: str) -> Home:
        """The same place without some variables."""
        other = Home(Path(self.environment["XDG_RUNTIME_DIR"]), self.prefix)
        other.environment = {name: value for name, value in self.environment.items() if name not in variables}
        return other


@contextmanager
def new_home(prefix: tuple[str, ...] = ()) -> Iterator[Home]:
    """A home with a path that is short enough for a socket, whatever the folder of the tests is called."""
    folder = Path(tempfile.mkdtemp(prefix="st-"))
    try:
        yield Home(folder, prefix)
    finally:
        shutil.rmtree(folder)


def demo_episode(home: Home, done: subprocess.CompletedProcess[str]) -> Path:
    """Return the only episode that a demo has recorded."""
    assert done.returncode == 0, done.stderr
    (folder,) = (home.data / "demo").iterdir()
    return folder


def are_gone(pids: Sequence[int]) -> bool:
    """Whether none of some processes runs any more."""
    return not any(is_running(pid) for pid in pids)


def row(rows: list[dict[str, Any]], **wanted: str) -> dict[str, Any]:
    """Return the only row with some values."""
    (found,) = [row for row in rows if wanted.items() <= row.items()]
    return found


def status_of_motion(home: Home) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what ``station status`` says of the motion server of a station, and of its key."""
    found = home.json("status")
    motion = row(found["servers"], name="motion")
    assert motion["state"] == "active"
    assert motion["pid"] == home.pids()["motion"]
    assert row(found["servers"], name="recorder")["state"] == "active"
    body = row(found["keys"], key=twist_keys.action_body())
    assert body["writer"] == "motion"
    return motion, body


def one_line(done: subprocess.CompletedProcess[str]) -> str:
    """Return the one line that a refused command ends in; fail when it says more, or prints to stdout."""
    lines = done.stderr.strip().splitlines()
    assert done.returncode in (1, 2), f"exit code {done.returncode}: {done.stderr}"
    assert done.stdout == ""
    assert len(lines) == 1, f"more than a line:\n{done.stderr}"
    assert lines[0].startswith("station: ")
    return lines[0].removeprefix("station: ")
