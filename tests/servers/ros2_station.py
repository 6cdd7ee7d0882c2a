"""The ROS 2 bridge as a process of its own on a real bus, beside a real node of ROS."""

from __future__ import annotations

import contextlib
import json
import os
import signal
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from station.bus.address import BusAddress
from tests.dds_domains import domain
from tests.ros import Peer, peer, ros_python
from tests.servers.bridge_station import BridgeStation
from tests.waiting import is_running, wait_until


class Ros2Station(BridgeStation):
    """The bridge, all that it writes to the bus, and a node of ROS that meets it.

    Args:
        address: Of the bus.
        folder: For its table and last words.
        ros_domain: Where both are.
        node: Of ROS.
    """

    def __init__(self, address: BusAddress, folder: Path, ros_domain: int, node: Peer) -> None:
        super().__init__("ros2", address, folder)
        self._folder, self.domain, self.peer = folder, ros_domain, node
        self._nodes: set[int] = set()

    def launch(self, *, inside: Sequence[str] = (), url: str = "", **settings: Any) -> None:
        """Start the server with a table, a file's or one that is given."""
        if not isinstance(table := settings["table"], str):
            path = self._folder / "table.yaml"
            path.write_text(json.dumps(table))  # YAML as well
            settings["table"] = str(path)
        found = {"python": ros_python(), "domain_id": self.domain, **settings}
        super().launch(inside=inside, url=url, **found)

    def node(self) -> int:
        """Return the process of the bridge's node."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        found = [int(pid) for pid in children if "station_node" in Path(f"/proc/{pid}/cmdline").read_text()]
        self._nodes.update(found)
        return found[0]

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
