"""From a write on the bus to a channel of the file: its writer, its encoding, how many were lost before."""

from __future__ import annotations

import json

import mcap.records
import msgspec

from station.bus import stamp as stamps
from station.contract import Contract
from station.episode.storage import layout
from station.episode.storage.manifest import Stream

MAX_CHANNELS = 16_000
"""A client that invents keys must fill neither the memory nor the file; each channel takes about 2 kB of both."""

_NANOSECONDS = 1e-9
_LARGEST_JSON = 1 << 20


class Channel:
    """One key as one source writes it, with the counters of this file.

    Attributes:
        id: Number in the file.
        key, source, encoding, file: As in `station.episode.storage.manifest.Stream`.
        contract: What the key holds; None where nothing describes it.
        shares_clock: Whether the source's monotonic clock is ours, so that its stamps fall on our time line.
        count, lost, repeated: Messages; sequence numbers missing between them, lost or dropped anywhere; messages
            that did not advance.
        last_sequence: Newest sequence number; of a foreign writer our own count.
        first_ns, last_ns: First and newest log time [ns].
        longest_gap_ns: Longest time between two log times [ns].
    """

    __slots__ = (
        "contract", "count", "encoding", "file", "first_ns", "id", "key", "last_ns", "last_sequence", "longest_gap_ns",
        "lost", "repeated", "shares_clock", "source",
    )  # fmt: skip

    def __init__(
        self, number: int, key: str, source: str, encoding: str, file: str = layout.SIGNALS,
        contract: Contract | None = None,
    ) -> None:  # fmt: skip
        self.id = number
        self.key = key
        self.source = source
        self.encoding = encoding
        self.file = file
        self.contract = contract
        self.shares_clock = stamps.boot_of(source) == stamps.boot_id()
        self.count = self.lost = self.repeated = self.last_sequence = 0
        self.first_ns = self.last_ns = self.longest_gap_ns = 0

    def count_message(self, sequence: int, log_ns: int) -> int:
        """Count one message; return how many sequence numbers before it are missing."""
        lost = 0
        if self.count:
            step = sequence - self.last_sequence
            if step > 1:
                lost = step - 1
                self.lost += lost
            elif step < 1:
                self.repeated += 1
            self.longest_gap_ns = max(self.longest_gap_ns, log_ns - self.last_ns)
        else:
            self.first_ns = log_ns
        self.count += 1
        self.last_ns = log_ns
        self.last_sequence = max(self.last_sequence, sequence) if self.count > 1 else sequence
        return lost

    def metadata(self) -> dict[str, str]:
        """Return what stands in the MCAP channel record."""
        text = msgspec.json.encode(self.contract).decode() if self.contract else layout.NO_CONTRACT
        found = {"source": self.source, "writer": self.writer, "contract": text}
        if self.source and not self.shares_clock:
            found |= layout.ON_EPISODE_CLOCK
        if self.topic != self.key:
            found["key_hex"] = self.key.encode("utf-8", "surrogateescape").hex()
        return found

    @property
    def topic(self) -> str:
        """The key as `topic_of` writes it."""
        return topic_of(self.key)

    @property
    def writer(self) -> str:
        """Name of the server that writes it, or ``foreign``."""
        return self.source.split(".", 1)[0] if self.source else layout.FOREIGN

    def stream(self, start_ns: int, dropped: tuple[int, int] = (0, 0)) -> Stream:
        """Return the manifest's entry: times relative to `start_ns`; how many writes, and bulky ones, were dropped."""
        span = (self.last_ns - self.first_ns) * _NANOSECONDS
        several = self.count > 1
        return Stream(
            key=self.topic,
            source=self.source,
            writer=self.writer,
            role=self.contract.role if self.contract else "unknown",
            contract=self.contract is not None,
            encoding=self.encoding,
            file=self.file,
            count=self.count,
            lost=max(0, self.lost - dropped[0]),
            dropped=dropped[0],
            dropped_bulky=dropped[1],
            repeated=self.repeated,
            rate_hz=round((self.count - 1) / span, 3) if several and span > 0 else None,
            longest_gap_s=round(self.longest_gap_ns * _NANOSECONDS, 6) if several else None,
            first_s=round((self.first_ns - start_ns) * _NANOSECONDS, 6) if self.count else None,
            last_s=round((self.last_ns - start_ns) * _NANOSECONDS, 6) if self.count else None,
        )


def topic_of(key: str) -> str:
    """Return a key as valid text; bytes of it that are no UTF-8 are written as escapes."""
    return key.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


def channel_from(record: mcap.records.Channel, file: str = layout.SIGNALS) -> Channel:
    """Return the channel that a record of a file describes, with nothing counted yet."""
    hexadecimal = record.metadata.get("key_hex", "")
    key = bytes.fromhex(hexadecimal).decode("utf-8", "surrogateescape") if hexadecimal else record.topic
    source, contract = record.metadata.get("source", ""), contract_of(record)
    return Channel(record.id, key, source, record.message_encoding, file, contract)


def contract_of(record: mcap.records.Channel) -> Contract | None:
    """Return the contract that stands in the record of a channel; one that we cannot read counts as none."""
    text = record.metadata.get("contract", layout.NO_CONTRACT)
    try:
        return None if text == layout.NO_CONTRACT else msgspec.json.decode(text, type=Contract)
    except (msgspec.DecodeError, RecursionError):
        return None


def encoding_of(value: bytes) -> str:
    """Return the encoding of a channel whose first value this is; megabytes are not parsed to learn that."""
    if len(value) > _LARGEST_JSON:
        return layout.BYTES
    try:
        json.loads(value.decode())  # given bytes, it guesses: b"7\0\0\0" would be a 7 in UTF-32
    except (ValueError, RecursionError):
        return layout.BYTES
    return layout.JSON


def source_of(stamp: bytes | None) -> str | None:
    """Return the source that a stamp names, or None when it is no stamp of ours or would break the list of stamps."""
    if stamp is None or b"\n" in stamp:
        return None
    decoded = stamps.decode(stamp)
    return decoded.source if decoded is not None and decoded.source else None
