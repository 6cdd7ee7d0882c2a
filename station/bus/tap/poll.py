"""The last resort: look at every key all the time and see what is different.

Loses whatever is overwritten within a period (measured at 100 Hz: 20 % of 1,000 writes a second over 8 keys), and a
foreign writer that repeats the same bytes is not seen at all.
"""

from __future__ import annotations

import logging

from station.bus.address import BusAddress
from station.bus.tap.base import MOST_KEYS, PROBE, Backend, Position, Write, connect, key_name, write_probe
from station.errors import BusError

log = logging.getLogger(__name__)

RATE_HZ = 200.0
_SCAN_PERIOD_S = 0.1  # how long a new key can stay unseen
_SCAN_COUNT = 1000
_ARM_TIMEOUT_S = 5.0

_Content = tuple[bytes, bytes | None]  # value and stamp of a key


class PollTap:
    """Writes by comparison.

    It looks at `MOST_KEYS` keys at most, and keeps what they held last.

    Args:
        address: The bus; only its database is tapped.
        resume: A position cannot be honoured here: `resumed` is then False.
        rate_hz: How often every key is read [Hz].

    Raises:
        BusError: the bus cannot be reached, or may not be read.

    Attributes:
        unseen_keys: The most keys so far that there were beyond those that it looks at.
    """

    backend: Backend = "poll"
    is_lossless = False
    is_catching_up = False

    def __init__(self, address: BusAddress, resume: Position | None = None, *, rate_hz: float = RATE_HZ) -> None:
        self.resumed = False if resume is not None else None
        self._address, self._clock = address, address.clock
        self._period_s = 1.0 / rate_hz
        self.unseen_keys = 0
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
        deadline = self._clock.monotonic_s() + timeout_s
        writes, self._waiting = self._waiting, []
        while not writes:
            self._clock.sleep(max(0.0, min(self._next_look, deadline) - self._clock.monotonic_s()))
            if self._clock.monotonic_s() >= self._next_look:
                writes = self._poll()
            if self._clock.monotonic_s() >= deadline:
                break
        return writes

    def may_wait(self) -> bool:
        """Return False: what is not read at once is overwritten."""
        return False

    def position(self) -> None:
        """Return None: what was missed cannot be asked for."""

    def close(self) -> None:
        """Hang up; a second call does nothing."""
        self._connection.close()

    def _arm(self) -> None:
        self._poll()  # what is there already is not new
        write_probe(self._connection)
        self._next_scan = 0.0
        deadline = self._clock.monotonic_s() + _ARM_TIMEOUT_S
        while self._clock.monotonic_s() < deadline:
            self._waiting += self._poll()
            if PROBE in self._keys:
                return
            self._clock.sleep(self._period_s)
        raise BusError(f"bus {self._address}: the probe key was written but is not among the keys that SCAN lists")

    def _poll(self) -> list[Write]:
        now = self._clock.monotonic_s()
        self._next_look = max(self._next_look + self._period_s, now)
        if now >= self._next_scan:
            self._next_scan = now + _SCAN_PERIOD_S
            self._keys = self._scan()
        contents = self._fetch()
        now_ns = self._clock.monotonic_ns()
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
        """Return the keys to look at: those that are known and still there, then new ones as long as there is room."""
        known = {PROBE, *self._keys}
        kept: dict[bytes, None] = {}
        new: dict[bytes, None] = {}
        beyond, cursor = 0, b"0"
        while True:
            cursor, page = self._connection.call("SCAN", cursor, "COUNT", _SCAN_COUNT)
            for key in page:
                if key in known:
                    kept[key] = None
                elif len(known) + len(new) < MOST_KEYS:
                    new[key] = None
                else:
                    beyond += key not in new
            if cursor == b"0":
                break
        if beyond > self.unseen_keys:
            if not self.unseen_keys:
                log.warning("more than %d keys: writes of %d keys or more are not seen", MOST_KEYS, beyond)
            self.unseen_keys = beyond
        return [*kept, *new]

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
