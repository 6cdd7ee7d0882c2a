"""The real recorder beside a benchmark."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec

from benchmarks import processes
from station.bus import keys
from station.bus.address import BusAddress
from station.bus.client import Bus

_READY_S = 30.0


@contextlib.contextmanager
def recorder(address: BusAddress, data: Path) -> Iterator[int]:
    """Run the real recorder on a bus; yields its process id when it is ready."""
    environment = {"STATION_BUS": address.url, "STATION_DATA": str(data), "XDG_RUNTIME_DIR": str(data)}
    log = data / "recorder.log"
    with processes.station("serve", "recorder", environment=environment, log=log) as process:
        wait_active(address, "recorder", process.pid, log)
        yield process.pid


def wait_active(address: BusAddress, name: str, pid: int, log: Path) -> None:
    """Wait until a server says that it is active."""
    deadline = time.monotonic() + _READY_S
    with Bus(address, name="bench") as line:
        while time.monotonic() < deadline:
            data = line.get(keys.server(name))
            health = msgspec.json.decode(data) if data else {}
            if health.get("pid") == pid and health.get("state") == "active":
                return
            time.sleep(0.02)
    raise RuntimeError(f"{name} was not active within {_READY_S:.0f} s; it said: {log.read_text()[-2000:]}")
