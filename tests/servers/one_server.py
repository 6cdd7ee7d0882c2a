"""One server as a process of its own on a real bus, and all that it writes."""

from __future__ import annotations

import subprocess
from abc import ABC, abstractmethod
from collections.abc import Callable
from itertools import groupby
from pathlib import Path

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.tap import Tap, Write, open_tap
from station.life import events
from station.life.events import Event
from tests.waiting import DEADLINE_S, wait_until


class OneServer(ABC):
    """The process, from its start to its last words; who derives starts it and keeps what it writes.

    Args:
        address: Of the bus.
        words: File of its standard error.
    """

    def __init__(self, address: BusAddress, words: Path) -> None:
        self._address, self._words = address, words
        self.events: list[Event] = []
        self._tap: Tap = open_tap(address)
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def process(self) -> subprocess.Popen[bytes]:
        """The server's process."""
        assert self._process is not None
        return self._process

    def until(self, condition: Callable[[], object]) -> None:
        """Read what is written until a condition holds."""

        def holds() -> object:
            self._take()
            assert self.process.poll() is None, self.last_words()
            return condition()

        wait_until(holds, 2 * DEADLINE_S)

    def stop(self) -> int:
        """Ask it to finish; return its exit code."""
        self.process.terminate()
        return self.process.wait(DEADLINE_S)

    def ends(self) -> tuple[int, str]:
        """Wait for its end by itself; return exit code and the last line it printed."""
        return self.process.wait(2 * DEADLINE_S), self.last_words()

    def last_words(self) -> str:
        """Return the last line it printed."""
        lines = self._words.read_text().splitlines()
        return lines[-1] if lines else ""

    def close(self) -> None:
        """Kill what still runs."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._tap.close()

    @abstractmethod
    def _keep(self, writes: list[Write]) -> None:
        """Keep what was written at once."""

    def _take(self) -> None:
        for _, group in groupby(self._tap.read(0.05), lambda write: write.stamp and write.stamp.split()[1]):
            writes = list(group)
            for write in writes:
                if write.key == keys.EVENT and (event := events.decode(write.value or b"")) is not None:
                    self.events.append(event)
            self._keep(writes)
