"""Every stop is obeyed by a real robot's server, however soon it is followed by its release or by its deletion."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import closing
from functools import partial

import pytest

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.connection import Connection
from station.life.events import decode
from tests.control.test_stop_trace import HIDDEN
from tests.servers.g1_station import LIGHT, G1Process, Log, logged
from tests.waiting import wait_until

TRIALS = 200
GAPS_S = (0.0, 0.0001, 0.0002, 0.0005, 0.001)


def release_after(gap_s: float, line: Connection) -> None:
    line.call("SET", keys.ESTOP, b"1")
    end_s = time.perf_counter() + gap_s
    while time.perf_counter() < end_s:  # a sleep would be longer
        pass
    line.call("SET", keys.ESTOP, b"0")


def at_once(how: str, line: Connection) -> None:
    line.pipeline(HIDDEN[how])


KINDS: dict[str, Callable[[Connection], None]] = {
    **{f"released after {gap_s * 1e3:g} ms": partial(release_after, gap_s) for gap_s in GAPS_S},
    **{how: partial(at_once, how) for how in HIDDEN if how != "moved"},  # the second would find the first there
}


class Counted:
    """How often the robot stopped and was released, by its events."""

    def __init__(self, log: Log) -> None:
        self._log, self._seen = log, 0
        self.names: list[str] = []

    def of(self, name: str) -> int:
        written = self._log.of(keys.EVENT)
        for write in written[self._seen :]:
            event = decode(write.value or b"")
            self.names += [event.name] if event is not None else []
        self._seen = len(written)
        return self.names.count(name)


@pytest.mark.parametrize("kind", KINDS)
def test_no_stop_escapes_the_robot(bus_server: BusAddress, kind: str, proof: object) -> None:
    with (
        logged(bus_server) as log,
        G1Process(bus_server, *LIGHT) as robot,
        closing(Connection(bus_server, timeout_s=5.0)) as line,
    ):
        assert robot.process.stderr is not None
        threading.Thread(target=robot.process.stderr.read, daemon=True).start()  # a full pipe would hold it up
        wait_until(lambda: log.gate()["state"] == "waiting")
        counted = Counted(log)
        for trial in range(TRIALS):
            KINDS[kind](line)
            wait_until(lambda trial=trial: counted.of("estop") > trial, 10.0)  # type: ignore[misc]
            while counted.of("operator-reset") <= trial:
                line.call("SET", keys.ESTOP, b"0")
                time.sleep(0.05)
        assert counted.of("estop") == TRIALS
