"""The last resort: look at every key all the time and see what is different.

Loses whatever is overwritten within a period (measured at 100 Hz: 20 % of 1,000 writes a second over 8 keys), and a
foreign writer that repeats the same bytes is not seen at all.
"""

from __future__ import annotations

import time

from station.bus.address import BusAddress
from station.bus.tap.base import PROBE, Backend, Position, Write, connect, key_name, write_probe
from station.errors import BusError

RATE_HZ = 200.0
_SCAN_PERIOD_S = 0.1  # how long a new key can stay unseen
_SCAN_COUNT = 1000
_ARM_TIMEOUT_S = 5.0

_Content = tuple[bytes, bytes | None]  # value and stamp of a key


class PollTap:
    """Writes by comparison.

    Args:
        address: The bus; only its database is tapped.
        resume: A position cannot be honoured here: `resumed` is then False.
        rate_hz: How often every key is read [Hz].

    Raises:
        BusError: the bus cannot be reached, or may not be read.
    """

    backend: Backend = "poll"
    is_lossless = False

    def __init__(self, address: BusAddress, resume: Position | None = None, *, rate_hz: float = RATE_HZ) -> None:
        self.resumed = False if resume is not None else None
        self._address = address
        self._period_s = 1.0 / rate_hz
        self._keys: list[bytes] = []
        self._contents: dict[bytes, _Content] = {}
        self._waiting: list[Write] = []
        self._next_scan = 0.0
        self._next_look = 0.0
        self._connection = connect(address)
        try:
            self._arm()
        except BaseException:
            self._connection.close()
            raise

    def read(self, timeout_s: float) -> list[Write]:
        """Return what is different from the last look, one write per key; empty when nothing changed in time."""
        deadline = time.monotonic() + timeout_s
        writes, self._waiting = self._waiting, []
        while not writes:
            time.sleep(max(0.0, min(self._next_look, deadline) - time.monotonic()))
            if time.monotonic() >= self._next_look:
                writes = self._look()
            if time.monotonic() >= deadline:
                break
        return writes

    def position(self) -> None:
        """Return None: what was missed cannot be asked for."""

    def close(self) -> None:
        """Hang up; a second call does nothing."""
        self._connection.close()

    def _arm(self) -> None:
        self._look()  # what is there already is not new
        token = write_probe(self._connection)
        self._next_scan = 0.0
        deadline = time.monotonic() + _ARM_TIMEOUT_S
        while time.monotonic() < deadline:
            self._waiting += self._look()
            if PROBE in self._keys and self._connection.call("GET", PROBE) == token:
                return
            time.sleep(self._period_s)
        raise BusError(f"bus {self._address}: the probe key was written but is not among the keys that SCAN lists")

    def _look(self) -> list[Write]:
        now = time.monotonic()
        self._next_look = max(self._next_look + self._period_s, now)
        if now >= self._next_scan:
            self._next_scan = now + _SCAN_PERIOD_S
            self._keys = self._scan()
        contents = self._fetch()
        now_ns = time.monotonic_ns()
        writes = [
            Write(key_name(key), None, None, now_ns)
            for key in self._contents
            if key not in contents and not _is_sibling(key, self._contents)
        ]
        for key, content in contents.items():
            known = self._contents.get(key)
            if content != known and not _is_sibling(key, contents):
                writes.append(Write(key_name(key), content[0], _own_stamp(content, known), now_ns))
        self._contents = contents
        return writes

    def _scan(self) -> list[bytes]:
        found: dict[bytes, None] = {}
        cursor = b"0"
        while True:
            cursor, page = self._connection.call("SCAN", cursor, "COUNT", _SCAN_COUNT)
            found.update(dict.fromkeys(page))
            if cursor == b"0":
                return list(found)

    def _fetch(self) -> dict[bytes, _Content]:
        """Return what every string key holds now; one request, so that a value and its stamp belong together."""
        wanted = [key for key in self._keys if key != PROBE]
        if not wanted:
            return {}
        present = set(wanted)
        names = [*wanted, *(key + b"@" for key in wanted if key + b"@" not in present and not key.endswith(b"@"))]
        values = {
            name: value
            for name, value in zip(names, self._connection.call("MGET", *names), strict=True)
            if value is not None
        }
        return {key: (values[key], values.get(key + b"@")) for key in wanted if key in values}


def _is_sibling(key: bytes, contents: dict[bytes, _Content]) -> bool:
    """Whether a key is the stamp of another."""
    return key.endswith(b"@") and key[:-1] in contents


def _own_stamp(content: _Content, known: _Content | None) -> bytes | None:
    """Return the stamp that was written with the value; one that stood still belongs to an earlier write."""
    return content[1] if known is None or content[1] != known[1] else None
