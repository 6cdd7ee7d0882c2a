"""A simulated G1 that stands and waits for commands, with a console on its bus."""

from __future__ import annotations

import signal
import subprocess
from contextlib import ExitStack
from pathlib import Path

import pytest

from adapters.robots.g1 import twist_keys
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.life import estop
from tests.faults.bus_station import pid_of
from tests.main_job.station_runs import Terminal
from tests.waiting import bus_answers, wait_until
from tests.web.console_process import ConsoleProcess

ROBOT = twist_keys.TWIST2_ROBOT
GATE = keys.command_gate(ROBOT)


class Standing:
    """A simulated G1 that stands and waits, and a console on its bus."""

    def __init__(self, folder: Path) -> None:
        self.terminal = Terminal(folder)
        self.folder = folder
        self.address = BusAddress(socket=f"{self.terminal.environment['XDG_RUNTIME_DIR']}/station/bus.sock")
        with ExitStack() as ends:  # if one of these fails, those before it are ended
            self._ends = ends
            self._start("bus", "start")
            wait_until(lambda: bus_answers(self.address))
            self.bus_pid = pid_of(self.address)
            self._station = self._start("serve", "g1")
            self.bus = ends.enter_context(Bus(self.address, name="test", timeout_s=5.0))
            self.console = self.new_console()
            self.wait_for_gate("waiting")
            self._ends = ends.pop_all()

    def _start(self, *command: str) -> subprocess.Popen[str]:
        process = self.terminal.start(*command)
        self._ends.callback(process.communicate, timeout=60)
        self._ends.callback(process.send_signal, signal.SIGINT)
        return process

    def new_console(self, *more: str, port: int = 0) -> ConsoleProcess:
        """Start a console, which is killed at the end if it has not been before."""
        with pytest.MonkeyPatch.context() as patch:
            for name, value in self.terminal.environment.items():
                patch.setenv(name, value)
            console = ConsoleProcess(self.address, self.folder, *more, port=port)
        self._ends.callback(console.kill)
        return console

    def gate(self) -> str:
        """What the robot's gate says."""
        return str(codec.parse_facts(self.bus.get(GATE)).get("state", ""))

    def wait_for_gate(self, state: str) -> None:
        """Wait until it says something."""

        def says() -> bool:
            assert self._station.poll() is None, self._station.communicate()[0]
            return self.gate() == state

        wait_until(says)

    def wait_again(self) -> None:
        """Release the stop where one is latched."""
        if estop.latched(self.bus.read(estop.KEYS).get) is not None:
            assert self.terminal.run("estop", "--reset").returncode == 0
        self.wait_for_gate("waiting")

    def close(self) -> None:
        """End it all."""
        self._ends.close()
