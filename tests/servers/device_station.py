"""Device servers as processes of their own on a real bus, and an account of all they write."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import dropwhile, groupby, pairwise
from pathlib import Path
from typing import Any

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.sample import Sample
from station.bus.tap import Write
from station.operator import sample as readings
from station.operator.sample import OperatorSample, Status
from tests.servers.one_server import OneServer

RUN = """
import json, sys
from station import registry
from station.bus.address import parse
from station.config import build
from station.errors import StationError
from station.life.serving import serve
kind = registry.find("server", sys.argv[1])
try:
    sys.exit(serve(kind, build(kind.config, json.loads(sys.argv[3]), where="test"), address=parse(sys.argv[2])))
except StationError as error:
    sys.stderr.write(str(error) + "\\n")
    sys.exit(error.exit_code)
"""


class Station(OneServer):
    """One device server and everything that it writes to the bus.

    Args:
        device: Name of the server.
        address: Of the bus.
        folder: For its script and its last words.
    """

    def __init__(self, device: str, address: BusAddress, folder: Path) -> None:
        super().__init__(address, folder / "stderr")
        self.device, self._folder = device, folder
        self.samples: list[OperatorSample] = []
        self.statuses: list[Status] = []
        self.facts: dict[str, Any] = {}

    def start(self, steps: Sequence[Mapping[str, Any]] = (), *, before: str = "", **config: Any) -> None:
        """Start the server, on a fake with a script where there are steps; `before` is Python that runs first."""
        if steps:
            config["fake"] = str(self._folder / "script.json")
            Path(config["fake"]).write_text(json.dumps({"device": self.device, "steps": steps}))
        command = [sys.executable, "-c", before + RUN, self.device, self._address.url, json.dumps(config)]
        with self._words.open("wb") as stderr:
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=stderr)

    def states(self) -> list[str]:
        """Return the states that were told, in order."""
        told = [event.name.removeprefix("operator-") for event in self.events if event.name.startswith("operator-")]
        return [state for state, _ in groupby(told)]

    def lasting(self) -> list[str]:
        """Return the states that were told, in order, without ``stale``, which a busy machine adds for a moment."""
        return [state for state, _ in groupby(state for state in self.states() if state != "stale")]

    def until_back(self, reason: str, *, beside: Callable[[], object]) -> None:
        """Wait until it was told that the device is lost for a reason and, since then, live, and something is so."""

        def is_back() -> bool:
            since = dropwhile(
                lambda event: event.name != "operator-lost" or reason not in str(event.detail), self.events
            )
            return any(event.name == "operator-live" for event in since)

        self.until(lambda: is_back() and bool(beside()))

    def _keep(self, writes: list[Write]) -> None:
        values = {write.key: write.value or b"" for write in writes}
        if keys.server_config(self.device) in values:
            self.facts = json.loads(values[keys.server_config(self.device)])
        samples = {key: Sample(key, value, None, 0) for key, value in values.items()}
        status = readings.decode_status(self.device, samples)
        if status is not None:
            self.statuses.append(status)
            if len(values) > 1:
                self.samples.append(readings.decode(self.device, samples))


def presses(typist: Station, key: str = "w") -> int:
    """Return how often a key of a keyboard was seen to be pressed."""
    held = [0.0, *(sample.controls.get(f"key_{key}", 0.0) for sample in typist.samples)]
    return sum(before < after for before, after in pairwise(held))


@contextlib.contextmanager
def station(device: str, address: BusAddress, folder: Path) -> Iterator[Station]:
    """Give a station that is closed at the end."""
    made = Station(device, address, folder)
    try:
        yield made
    finally:
        made.close()
