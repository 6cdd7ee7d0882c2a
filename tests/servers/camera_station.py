"""A camera server as a process of its own, started as a person starts it, and an account of all it writes."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from station.bus import keys
from station.bus import stamp as stamps
from station.bus.address import BusAddress
from station.bus.stamp import Stamp
from station.bus.tap import Tap, open_tap
from station.life import events
from station.life.events import Event
from station.life.server import Health, decode_health
from tests.waiting import DEADLINE_S, wait_until


class Shot(NamedTuple):
    """A picture as it was written."""

    jpeg: bytes
    stamp: Stamp


class CameraStation:
    """One camera server and everything that it writes to the bus.

    Args:
        name: Of the server, and so of the camera.
        address: Of the bus.
        folder: For its last words.
    """

    def __init__(self, name: str, address: BusAddress, folder: Path) -> None:
        self.name, self._address, self._folder = name, address, folder
        self.shots: list[Shot] = []
        self.events: list[Event] = []
        self.facts: dict[str, Any] = {}
        self.health: Health | None = None
        self._tap: Tap = open_tap(address)
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, source: str, *, environment: Mapping[str, str] | None = None, **settings: Any) -> None:
        """Start the server; settings of its source are given as ``options={…}``."""
        config = json.dumps({"source": source, **settings})
        command = [sys.executable, "-m", "station", "serve", "camera", "--name", self.name, "--bus", self._address.url,
                   "--config-json", config]  # fmt: skip
        with (self._folder / f"{self.name}.err").open("wb") as stderr:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=stderr,
                stderr=stderr,
                env={**os.environ, **(environment or {})},
            )

    @property
    def process(self) -> subprocess.Popen[bytes]:
        """The server's process."""
        assert self._process is not None
        return self._process

    @property
    def detail(self) -> dict[str, Any]:
        """What it last said of itself."""
        return self.health.detail if self.health is not None else {}

    def until(self, condition: Callable[[], object]) -> None:
        """Read what is written until a condition holds."""

        def holds() -> object:
            self._take()
            assert self.process.poll() is None, self.last_words()
            return condition()

        wait_until(holds, 2 * DEADLINE_S)

    def until_active(self) -> None:
        """Wait until it publishes."""
        self.until(lambda: self.health is not None and self.health.state == "active")

    def told(self, name: str) -> list[Event]:
        """Return the events of a name, oldest first."""
        return [event for event in self.events if event.name == name]

    def stop(self) -> int:
        """Ask it to finish; return its exit code."""
        self.process.terminate()
        return self.process.wait(DEADLINE_S)

    def ends(self) -> tuple[int, str]:
        """Wait for its end by itself; return exit code and the last line it printed."""
        return self.process.wait(2 * DEADLINE_S), self.last_words()

    def last_words(self) -> str:
        """Return the last line it printed."""
        lines = (self._folder / f"{self.name}.err").read_text().splitlines()
        return lines[-1] if lines else ""

    def close(self) -> None:
        """Kill what still runs."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._tap.close()

    def _take(self) -> None:
        for _, group in groupby(self._tap.read(0.05), lambda write: write.stamp and write.stamp.split()[1]):
            writes = list(group)
            values = {write.key: write.value or b"" for write in writes}
            event = events.decode(values.get(keys.EVENT, b""))
            if event is not None:
                self.events.append(event)
            if keys.server_config(self.name) in values:
                self.facts = json.loads(values[keys.server_config(self.name)])
            if keys.server(self.name) in values:
                self.health = decode_health(values[keys.server(self.name)])
            for write in writes:
                if write.key == keys.camera_image(self.name) and write.value is not None:
                    mark = stamps.decode(write.stamp or b"")
                    assert mark is not None
                    self.shots.append(Shot(write.value, mark))


@contextlib.contextmanager
def camera_station(name: str, address: BusAddress, folder: Path) -> Iterator[CameraStation]:
    """Give a camera server that is closed at the end."""
    made = CameraStation(name, address, folder)
    try:
        yield made
    finally:
        made.close()
