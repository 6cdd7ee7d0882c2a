"""Two writers beside a station, each with its own count of what it wrote."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager

import redis

from station.bus.address import BusAddress
from station.bus.client import Bus
from station.life.loop import Rate

FOREIGN_KEY = "somebody/else's key"
NATIVE_KEY = "a_sensor"
NATIVE_HZ = 200.0
_FOREIGN_S = 0.004


class ForeignWriter:
    """Plain ``SET`` by redis-py of a key that no contract knows: text, bytes, repeats, several in one go.

    Attributes:
        written: Every value that the server took, in order.
    """

    def __init__(self, address: BusAddress) -> None:
        self._redis = redis.Redis(unix_socket_path=address.socket, db=address.db)
        self._random = random.Random(7)
        self.written: list[bytes] = []

    def tick(self) -> None:
        """Write one to three values."""
        values = [self._value() for _ in range(self._random.choice((1, 1, 1, 2, 3)))]
        if len(values) == 1:
            self._redis.set(FOREIGN_KEY, values[0])
        else:
            with self._redis.pipeline() as pipeline:  # MULTI … EXEC: stock teleoperation does so
                for value in values:
                    pipeline.set(FOREIGN_KEY, value)
                pipeline.execute()
        self.written += values
        time.sleep(_FOREIGN_S)

    def close(self) -> None:
        self._redis.close()

    def _value(self) -> bytes:
        kind = self._random.random()
        if kind < 0.1 and self.written:
            return self.written[-1]
        if kind < 0.5:
            return self._random.randbytes(self._random.randrange(3000))
        return repr([self._random.random() for _ in range(35)]).encode()


class NativeWriter:
    """A sensor of the station, two keys per write, at a fixed rate; `count` writes were taken by the bus."""

    def __init__(self, address: BusAddress) -> None:
        self._bus = Bus(address, name="sensor", timeout_s=5.0)
        self._rate = Rate(NATIVE_HZ)
        self.source = self._bus.source
        self.count = 0

    def tick(self) -> None:
        """Wait for the next deadline, then write."""
        self._rate.wait()
        assert self._bus.publish({NATIVE_KEY: b"%d" % self.count, f"{NATIVE_KEY}/raw": self.count.to_bytes(8, "big")})
        self.count += 1

    def close(self) -> None:
        self._bus.close()


@contextmanager
def running(writer: ForeignWriter | NativeWriter) -> Iterator[None]:
    """Let a writer tick in a thread for the length of a block; raises what it raised."""
    stop = threading.Event()

    def tick() -> None:
        while not stop.is_set():
            writer.tick()

    with ThreadPoolExecutor(1) as pool:
        ticking = pool.submit(tick)
        try:
            yield
        finally:
            stop.set()
            wait([ticking])
            writer.close()
        ticking.result()
