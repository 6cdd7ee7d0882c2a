"""The ROS 2 bridge as a process of its own on a real bus, beside a real node of ROS."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.tap import Write
from station.life.events import Event
from station.life.server import decode_health
from tests.dds_domains import domain
from tests.ros import Peer, peer, ros_python
from tests.servers.device_station import RUN
from tests.servers.one_server import OneServer
from tests.waiting import DEADLINE_S, is_running, wait_until


class Ros2Station(OneServer):
    """The bridge, all that it writes to the bus, and a node of ROS that meets it.

    Args:
        address: Of the bus.
        folder: For its table and last words.
        ros_domain: Where both are.
        node: Of ROS.
    """

    def __init__(self, address: BusAddress, folder: Path, ros_domain: int, node: Peer) -> None:
        super().__init__(address, folder / "stderr")
        self._folder, self.domain, self.peer = folder, ros_domain, node
        self.written: dict[str, list[bytes]] = defaultdict(list)
        self.detail: dict[str, Any] = {}
        self.state = ""
        self._nodes: set[int] = set()

    def start(self, table: dict[str, Any] | str, **config: Any) -> None:
        """Start the server with a table and wait until it is active."""
        if not isinstance(table, str):
            path = self._folder / "table.yaml"
            path.write_text(json.dumps(table))  # YAML as well
            table = str(path)
        settings = {"table": table, "python": ros_python(), "domain_id": self.domain, **config}
        command = [sys.executable, "-c", RUN, "ros2", self._address.url, json.dumps(settings)]
        with self._words.open("wb") as stderr:
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=stderr)
        self.until(lambda: self.state == "active" and self.detail)

    def node(self) -> int:
        """Return the process of the bridge's node."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        found = [int(pid) for pid in children if "station_node" in Path(f"/proc/{pid}/cmdline").read_text()]
        self._nodes.update(found)
        return found[0]

    def numbers(self, key: str) -> list[list[float]]:
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
        """Kill what still runs, and wait until the node has ended, which it does by itself."""
        if self._process is not None and self._process.poll() is None:
            with contextlib.suppress(OSError, IndexError):
                self.node()
        super().close()
        for pid in self._nodes:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
            wait_until(lambda pid=pid: not is_running(pid))

    def _keep(self, writes: list[Write]) -> None:
        for write in writes:
            value = write.value or b""
            if write.key == keys.server("ros2") and (health := decode_health(value)) is not None:
                self.state, self.detail = health.state, health.detail
            elif write.key.startswith(keys.action("")):
                self.written[write.key].append(value)


@contextlib.contextmanager
def ros2_station(address: BusAddress, folder: Path) -> Iterator[Ros2Station]:
    """Give a bridge that is closed at the end, and a node of ROS."""
    ros_python()
    with domain() as number, peer(number) as node:
        made = Ros2Station(address, folder, number, node)
        try:
            yield made
        finally:
            made.close()
