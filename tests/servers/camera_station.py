"""A camera server as a process of its own, started as a person starts it, and an account of all it writes."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from station.bus import keys
from station.bus import stamp as stamps
from station.bus.address import BusAddress
from station.bus.stamp import Stamp
from station.bus.tap import Write
from station.life.events import Event
from station.life.server import Health, decode_health
from tests.servers.one_server import OneServer


class Shot(NamedTuple):
    """A picture as it was written."""

    jpeg: bytes
    stamp: Stamp


class CameraStation(OneServer):
    """One camera server and everything that it writes to the bus.

    Args:
        name: Of the server, and so of the camera.
        address: Of the bus.
        folder: For its last words.
    """

    kind = "camera"
    key = staticmethod(keys.camera_image)

    def __init__(self, name: str, address: BusAddress, folder: Path) -> None:
        super().__init__(address, folder / f"{name}.err")
        self.name = name
        self.shots: list[Shot] = []
        self.facts: dict[str, Any] = {}
        self.health: Health | None = None

    def start(self, source: str, *, environment: Mapping[str, str] | None = None, **settings: Any) -> None:
        """Start the server; settings of its source are given as ``options={…}``."""
        config = json.dumps({"source": source, **settings})
        command = [sys.executable, "-m", "station", "serve", self.kind, "--name", self.name, "--bus", self._address.url,
                   "--config-json", config]  # fmt: skip
        with self._words.open("wb") as stderr:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=stderr,
                stderr=stderr,
                env={**os.environ, **(environment or {})},
            )

    @property
    def detail(self) -> dict[str, Any]:
        """What it last said of itself."""
        return self.health.detail if self.health is not None else {}

    def until_active(self) -> None:
        """Wait until it publishes."""
        self.until(lambda: self.health is not None and self.health.state == "active")

    def told(self, name: str) -> list[Event]:
        """Return the events of a name, oldest first."""
        return [event for event in self.events if event.name == name]

    def _keep(self, writes: list[Write]) -> None:
        for write in writes:
            value = write.value or b""
            if write.key == keys.server_config(self.name):
                self.facts = json.loads(value)
            elif write.key == keys.server(self.name):
                self.health = decode_health(value)
            elif write.key == self.key(self.name) and value:
                mark = stamps.decode(write.stamp or b"")
                assert mark is not None
                self.shots.append(Shot(value, mark))


@contextlib.contextmanager
def camera_station(name: str, address: BusAddress, folder: Path) -> Iterator[CameraStation]:
    """Give a camera server that is closed at the end."""
    made = CameraStation(name, address, folder)
    try:
        yield made
    finally:
        made.close()
