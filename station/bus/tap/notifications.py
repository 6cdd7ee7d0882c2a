"""The second-best tap: the server says which key changed, and we read what it holds by then.

Good for about a thousand writes a second in sum; above that, values are overwritten before they are read. Stamps of
native writers tell afterwards how many are missing.
"""

from __future__ import annotations

import logging
from typing import NamedTuple

from station.bus import keys
from station.bus.address import BusAddress
from station.bus.connection import ConnectionLost, pack
from station.bus.notifications import ASK_FLAGS, flags_of, missing_events, switch_on, taken_away
from station.bus.tap.base import (
    MOST_KEYS,
    PROBE,
    Backend,
    Position,
    TapRefused,
    Write,
    connect,
    key_name,
    write_probe,
)

log = logging.getLogger(__name__)

_ARM_TIMEOUT_S = 2.0
_IDLE_CHECK_S = 2.0  # the server is questioned this often, so that one is noticed that is frozen, or tells nothing
_NO_CHANGE = frozenset((b"expire", b"persist"))
_REMOVED = frozenset((b"del", b"expired", b"evicted", b"rename_from", b"move_from"))


class _Delivered(NamedTuple):
    """What was delivered of a key last: its value's hash in place of an image of 100 kB, and its stamp."""

    value_hash: int
    stamp: bytes | None


class NotificationTap:
    """Writes by keyspace notification.

    Of `MOST_KEYS` keys it remembers what it delivered. Beyond, those that were silent longest are forgotten, and the
    next write of one may be delivered twice.

    Args:
        address: The bus; only its database is tapped.
        resume: A position cannot be honoured here: `resumed` is then False.

    Raises:
        TapRefused: the server sends no notifications to us.
        BusError: it cannot be reached.

    Attributes:
        forgotten: How often a key was forgotten.
    """

    backend: Backend = "notifications"
    is_lossless = False
    is_catching_up = False
    unseen_keys = 0

    def __init__(self, address: BusAddress, resume: Position | None = None) -> None:
        self.resumed = False if resume is not None else None
        self._address, self._clock = address, address.clock
        self._prefix = f"__keyspace@{address.db}__:".encode()
        self.forgotten = 0
        self._delivered: dict[bytes, _Delivered] = {}  # the newest last
        self._unstamped: set[bytes] = set()  # keys whose last notification was not followed by their stamp's, so far
        self._waiting: list[Write] = []
        self._checked_at = self._clock.monotonic_s()
        self._values = connect(address)
        try:
            self._events = connect(address)
            try:
                self._arm()
            except BaseException:
                self._events.close()
                raise
        except BaseException:
            self._values.close()
            raise

    def read(self, timeout_s: float) -> list[Write]:
        """Return what changed, in order of the first notification; empty when nothing came in time."""
        deadline = self._clock.monotonic_s() + timeout_s
        writes, self._waiting = self._waiting, []
        while not writes:
            writes = self._read_writes(self._wait_for_events(max(0.0, deadline - self._clock.monotonic_s())))
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
        self._events.close()
        self._values.close()

    def _arm(self) -> None:
        refusal = switch_on(self._values)  # no failure yet: another client may have, and the probe will tell
        self._subscribe()
        write_probe(self._values)
        deadline = self._clock.monotonic_s() + _ARM_TIMEOUT_S
        while self._clock.monotonic_s() < deadline:
            events = self._wait_for_events(0.05)
            self._waiting += self._read_writes(events)
            if (PROBE, b"set") in events:  # ours, or that of a tap that opens at the same time: this line tells of it
                return
        raise TapRefused(f"bus {self._address} sends no keyspace notifications ({refusal or 'none came back'})")

    def _subscribe(self) -> None:
        try:
            self._events.send("PSUBSCRIBE", self._prefix + b"*")
            reply = self._events.receive(_ARM_TIMEOUT_S)
        except TimeoutError as error:
            raise ConnectionLost(f"bus {self._address}: no answer in time") from error
        if isinstance(reply, Exception):
            raise TapRefused(f"bus {self._address} refuses subscriptions: {reply}")

    def _wait_for_events(self, timeout_s: float) -> list[tuple[bytes, bytes]]:
        """Return (key, what happened) for everything that has come; waits for the first."""
        if self._clock.monotonic_s() - self._checked_at > _IDLE_CHECK_S:
            self._checked_at = self._clock.monotonic_s()
            self._check()
        try:
            message = self._events.receive(min(timeout_s, _IDLE_CHECK_S))
        except TimeoutError:
            return []
        events = []
        while message is not False:
            if message[0] == b"pmessage":
                events.append((message[2][len(self._prefix) :], message[3]))
            message = self._events.buffered()
        return events

    def _check(self) -> None:
        """Expect that the server answers, and that it still tells of writes, where we may ask what it does.

        Raises:
            ConnectionLost: it is frozen or gone, or some client switched notifications off for all.
        """
        answer = self._values.send_packed(pack(*ASK_FLAGS))[0]
        if isinstance(answer, list) and answer and missing_events(flags := flags_of(answer)):
            self.close()
            raise ConnectionLost(f"bus {self._address}: {taken_away(flags)}")

    def _read_writes(self, events: list[tuple[bytes, bytes]]) -> list[Write]:
        events = [(key, what) for key, what in events if what not in _NO_CHANGE and key != PROBE]
        removed = {key for key, what in events if what in _REMOVED}
        foreign = self._foreign(events)
        wanted = list(dict.fromkeys(_owner(key) for key, _ in events))
        if not wanted:
            return []
        siblings = [name for key in wanted for name in (key, key + b"@")]
        values = self._values.call("MGET", *siblings)
        now_ns = self._clock.monotonic_ns()
        writes = []
        for key, value, stamp in zip(wanted, values[::2], values[1::2], strict=True):
            if value is None:
                if key in removed and self._forget(key):
                    writes.append(Write(key_name(key), None, None, now_ns))
            elif (write := self._new(key, value, stamp, is_foreign=key in foreign)) is not None:
                writes.append(Write(key_name(key), *write, now_ns))
        return writes

    def _forget(self, key: bytes) -> bool:
        """Forget a key that is gone; False for a stamp that was never delivered as a key of its own."""
        was_known = self._delivered.pop(key, None) is not None
        self._unstamped.discard(key)
        return was_known or not keys.is_stamp(key_name(key))

    def _foreign(self, events: list[tuple[bytes, bytes]]) -> set[bytes]:
        """Return the keys that were written by a command that did not write their stamp.

        A native write notifies of the key and then of its stamp, perhaps one batch later; so only the next
        notification of the same key tells that the last write had none.
        """
        found = set()
        for key, what in events:
            if key.endswith(b"@") or what in _REMOVED:
                self._unstamped.discard(_owner(key))
            elif key in self._unstamped:
                found.add(key)
            else:
                if len(self._unstamped) >= MOST_KEYS:  # one foreign write over a native key may then pass for native
                    self._unstamped.clear()
                self._unstamped.add(key)
        return found

    def _new(
        self, key: bytes, value: bytes, stamp: bytes | None, *, is_foreign: bool
    ) -> tuple[bytes, bytes | None] | None:
        """Return value and stamp of the write to deliver, or None when it was delivered already.

        A value is often read before its notification has come; the notification then finds nothing new. A stamp that
        stands still while its key is written means that a foreign script overwrote a native key.
        """
        known, new = self._delivered.pop(key, None), _Delivered(hash(value), stamp)
        self._delivered[key] = new
        if known is None and len(self._delivered) > MOST_KEYS:
            self._forget_oldest()
        if stamp is None or known is None or stamp != known.stamp:
            return value, stamp
        if new.value_hash != known.value_hash or is_foreign:
            return value, None
        return None

    def _forget_oldest(self) -> None:
        del self._delivered[next(iter(self._delivered))]
        if not self.forgotten:
            log.warning("more than %d keys: writes of those that are seldom written may be told twice", MOST_KEYS)
        self.forgotten += 1


def _owner(key: bytes) -> bytes:
    """Return the key to look at: a stamp stands for the key that it belongs to."""
    return key[:-1] if key.endswith(b"@") else key
