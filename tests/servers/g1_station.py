"""A real G1 server in a process of its own, everything that is written on its bus, and commanders of two kinds."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Any

import numpy as np

from adapters.robots.g1 import twist_keys
from station import registry
from station.bus import codec, keys
from station.bus.address import BusAddress
from station.bus.client import Bus
from station.bus.connection import Connection
from station.bus.tap import Write
from station.bus.tap.replication import ReplicationTap
from station.errors import BusError
from station.life.events import Event, decode
from station.protocols import Floats
from tests.waiting import DEADLINE_S, wait_until

ROBOT = twist_keys.TWIST2_ROBOT
FORMAT = registry.find("command", "twist2")
LIGHT = ("physics_dt_s=0.002", "real_time_priority=0")
"""Half the physics, and no more of the processor than anybody else: for tests that are about neither."""
PATIENT = (*LIGHT, "gate.hold_after_s=20.0", "gate.return_after_s=60.0", "gate.blend_in_s=0.3")
"""A robot that waits for its commander on a busy machine: for tests in which no commander falls silent."""
LEAVING = (*LIGHT, "gate.hold_after_s=4.0", "gate.return_after_s=5.0", "gate.blend_in_s=0.3", "gate.blend_out_s=1.0")
"""A robot that is left by its commander within a test, and not because a busy machine was late for a moment."""


class G1Process:
    """``station serve g1``; killed at the end if it does not go by itself."""

    def __init__(self, address: BusAddress, *settings: str, name: str = "g1") -> None:
        sets = [word for setting in settings for word in ("--set", setting)]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "station", "serve", "g1", "--bus", address.url, "--name", name, *sets],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=dict(os.environ), text=True,
        )  # fmt: skip

    def __enter__(self) -> G1Process:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.process.kill()
        self.process.communicate()

    def finish(self) -> tuple[int, str, str]:
        """Ask it to stop; return exit code, stdout and stderr."""
        self.process.send_signal(signal.SIGTERM)
        return self.result()

    def result(self) -> tuple[int, str, str]:
        out, err = self.process.communicate(timeout=60)
        return self.process.returncode, out, err


class Log:
    """Every write of a bus, in order, taken by a thread."""

    def __init__(self, address: BusAddress) -> None:
        self.writes: list[Write] = []
        self._by_key: dict[str, list[Write]] = {}  # without deletions; tests look often
        self._tap = ReplicationTap(address)
        self._tap._link.silence_limit_s = DEADLINE_S  # a bus that is frozen for a test is no reason to end
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._take, daemon=True)
        self._thread.start()

    def _take(self) -> None:
        while not self._stop.is_set():
            try:
                writes = self._tap.read(0.05)
            except BusError:
                return
            self.writes.extend(writes)
            for write in writes:
                if write.value is not None:
                    self._by_key.setdefault(write.key, []).append(write)

    def close(self) -> None:
        self._stop.set()
        self._thread.join(60)
        self._tap.close()

    def of(self, key: str) -> list[Write]:
        return list(self._by_key.get(key, ()))

    def values(self, key: str) -> list[bytes]:
        return [write.value for write in self.of(key) if write.value is not None]

    def last(self, key: str) -> bytes:
        wait_until(lambda: key in self._by_key)
        return self._by_key[key][-1].value or b""

    def events(self, *names: str) -> list[Event]:
        """Return the events of some names, in order."""
        found = [decode(value) for value in self.values(keys.EVENT)]
        return [event for event in found if event is not None and event.name in names]

    def wait_for(self, name: str, count: int = 1, timeout_s: float = DEADLINE_S) -> Event:
        """Wait until something was told so often; return the event."""
        wait_until(lambda: len(self.events(name)) >= count, timeout_s)
        return self.events(name)[count - 1]

    def gate(self) -> dict[str, Any]:
        return dict(codec.parse_json(self.last(keys.command_gate(ROBOT))))

    def states(self) -> list[str]:
        return [codec.parse_json(value)["state"] for value in self.values(keys.command_gate(ROBOT))]


@contextmanager
def logged(address: BusAddress) -> Iterator[Log]:
    log = Log(address)
    try:
        yield log
    finally:
        log.close()


class StockCommander:
    """What a stock TWIST2 script does, fifty times a second: plain SETs of JSON lists, nothing else."""

    def __init__(self, address: BusAddress, vector: Callable[[float], Floats] = lambda time_s: FORMAT.default) -> None:
        self._line, self._vector = Connection(address, timeout_s=5.0), vector
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> StockCommander:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._line.close()

    def _run(self) -> None:
        import json

        began = time.monotonic()
        while not self._stop.wait(0.02):
            vector = self._vector(time.monotonic() - began)
            self._line.call("SET", twist_keys.action_body(), json.dumps(vector.tolist()).encode())
            for side in ("left", "right"):
                self._line.call("SET", twist_keys.action_hand(side), json.dumps([0.0] * 7).encode())
            self._line.call("SET", twist_keys.action_neck(), json.dumps([0.0] * 2).encode())


def ticks(log: Log) -> int:
    """Return how many steps of the policy were seen."""
    return len(log.of(keys.policy_timing(ROBOT)))


def leaning(_time_s: float) -> Floats:
    """A command that no robot survives: lean back as far as is let through, and walk forward."""
    vector = FORMAT.default.copy()
    vector[[0, 4]] = 3.0, -1.3
    return np.asarray(vector)


def publish(bus: Bus, vector: Floats) -> None:
    bus.publish({twist_keys.action_body(): codec.json_vector(vector)})


def motion_process(address: BusAddress, *settings: str) -> subprocess.Popen[str]:
    sets = [word for setting in settings for word in ("--set", setting)]
    return subprocess.Popen(
        [sys.executable, "-m", "station", "serve", "motion", "--bus", address.url, *sets],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=dict(os.environ), text=True,
    )  # fmt: skip
