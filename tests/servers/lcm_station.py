"""The LCM bridge as a process of its own on a real bus, and whoever speaks LCM beside it, over real UDP."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from adapters.lcm.homie import CHANNELS
from adapters.lcm.multicast import Multicast
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.tap import Write
from station.life.events import Event
from station.life.server import decode_health
from tests.adapters.lcm.test_multicast import free_port
from tests.servers.device_station import RUN
from tests.servers.one_server import OneServer
from tests.waiting import DEADLINE_S

KINDS = {each.name: each for each in CHANNELS}
SOME_ARMS = [0.3, 0.2, 0.1, 0.5, 0.0, 0.1, 0.0, 0.3, -0.2, -0.1, 0.5, 0.0, 0.1, 0.0]


def message(channel: str, numbers: Sequence[float]) -> bytes:
    """Return a message of one of HOMIE's channels."""
    return KINDS[channel].kind.encode({KINDS[channel].field: list(numbers)})


class LcmStation(OneServer):
    """The bridge and all that it writes to the bus; `peer` speaks LCM on its port.

    Args:
        address: Of the bus.
        folder: For its last words.
    """

    def __init__(self, address: BusAddress, folder: Path) -> None:
        super().__init__(address, folder / "stderr")
        self.port = free_port()
        self.peer = Multicast(port=self.port)
        self.written: dict[str, list[bytes]] = defaultdict(list)
        self.detail: dict[str, Any] = {}
        self.state = ""

    def start(self, mode: str, *, inside: Sequence[str] = (), url: str = "", **config: Any) -> None:
        """Start the server and wait until it is active.

        Args:
            mode: Its mode.
            inside: What its command line begins with.
            url: Of the bus, where it is another user of it than this.
            config: Its further settings.
        """
        settings = json.dumps({"mode": mode, "port": self.port, **config})
        command = [*inside, sys.executable, "-c", RUN, "lcm", url or self._address.url, settings]
        with self._words.open("wb") as stderr:
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=stderr)
        self.until(lambda: self.state == "active" and self.detail)

    def send(self, channel: str, numbers: Sequence[float]) -> None:
        """Send a message as a cockpit does."""
        assert self.peer.send(channel, message(channel, numbers)) == ""

    def vectors(self, key: str) -> list[list[float]]:
        """Return the commands that were written on a key."""
        return [codec.parse_json_vector(value).tolist() for value in self.written[key]]

    def told(self, name: str) -> list[Event]:
        """Return the events of a name."""
        return [event for event in self.events if event.name == name]

    def interrupt(self) -> int:
        """Press Ctrl-C; return the exit code, once what was written until then is read."""
        self.process.send_signal(signal.SIGINT)
        code = self.process.wait(DEADLINE_S)
        self._take()
        return code

    def close(self) -> None:
        """Kill what still runs, and leave the group."""
        super().close()
        self.peer.close()

    def _keep(self, writes: list[Write]) -> None:
        for write in writes:
            value = write.value or b""
            if write.key == keys.server("lcm") and (health := decode_health(value)) is not None:
                self.state, self.detail = health.state, health.detail
            elif write.key.startswith(keys.action("")):
                self.written[write.key].append(value)


@contextlib.contextmanager
def lcm_station(address: BusAddress, folder: Path) -> Iterator[LcmStation]:
    """Give a bridge that is closed at the end."""
    made = LcmStation(address, folder)
    try:
        yield made
    finally:
        made.close()
