"""A bridge as a process of its own on a real bus, and all that it writes."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import threading
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.tap import Write
from station.life.events import Event
from station.life.server import decode_health
from tests.servers.device_station import RUN
from tests.servers.one_server import OneServer
from tests.waiting import DEADLINE_S


def free_port() -> int:
    """Return a TCP port that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as found:
        return int(found.getsockname()[1])


class BridgeStation(OneServer):
    """The server, what it tells of itself, and all commands, pictures and other values that it writes.

    Args:
        kind: Of the server.
        address: Of the bus.
        folder: For its last words.
    """

    def __init__(self, kind: str, address: BusAddress, folder: Path) -> None:
        super().__init__(address, folder / "stderr")
        self.kind = kind
        self.written: dict[str, list[bytes]] = defaultdict(list)
        self.writes: list[Write] = []
        self.detail: dict[str, Any] = {}
        self.state = ""

    def start(self, *, inside: Sequence[str] = (), url: str = "", **settings: Any) -> None:
        """Start the server and wait until it is active.

        Args:
            inside: What its command line begins with.
            url: Of the bus, where it is another user of it than this.
            settings: Its settings.
        """
        self.launch(inside=inside, url=url, **settings)
        self.state = ""
        self.until(lambda: self.state == "active" and self.detail)

    def launch(self, *, inside: Sequence[str] = (), url: str = "", **settings: Any) -> None:
        """Start the server."""
        command = [
            *inside,
            sys.executable,
            "-X",
            "faulthandler",
            "-c",
            RUN,
            self.kind,
            url or self._address.url,
            json.dumps(settings),
        ]
        with self._words.open("wb") as stderr:
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=stderr)

    def vectors(self, key: str) -> list[list[float]]:
        """Return the commands that were written on a key."""
        return [codec.parse_json_vector(value).tolist() for value in self.written[key]]

    def told(self, name: str) -> list[Event]:
        """Return the events of a name."""
        return [event for event in self.events if event.name == name]

    def interrupt(self) -> int:
        """Press Ctrl-C; return the exit code, once what was written until then is read."""
        self.process.send_signal(signal.SIGINT)
        try:
            code = self.process.wait(DEADLINE_S)
        except subprocess.TimeoutExpired:
            self.process.send_signal(signal.SIGABRT)  # it says where each of its threads is
            self.process.wait()
            raise AssertionError(self._words.read_text()) from None
        self._take()
        return code

    def _keep(self, writes: list[Write]) -> None:
        for write in writes:
            value = write.value or b""
            if write.key == keys.server(self.kind) and (health := decode_health(value)) is not None:
                self.state, self.detail = health.state, health.detail
            elif not write.key.startswith("station:"):
                self.writes.append(write)
                self.written[write.key].append(value)


class InThread:
    """Does `_run` in a thread of its own from when it is made until it is closed, upon which `_ends` is set."""

    def __init__(self) -> None:
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        self._ends.set()
        self._thread.join()

    def _run(self) -> None:
        raise NotImplementedError


class Writer(InThread):
    """Writes a command 50 times a second, as a teleoperation server does.

    Attributes:
        vector: What it writes; None for nothing.
    """

    def __init__(self, bus: Bus, key: str) -> None:
        self._bus, self._key = bus, key
        self.vector: Sequence[float] | np.ndarray | None = None
        super().__init__()

    def _run(self) -> None:
        while not self._ends.wait(0.02):
            if (vector := self.vector) is not None:
                self._bus.publish({self._key: codec.json_vector(np.array(vector))})
