"""What a reader of episodes hands out: channels, messages, vectors."""

from __future__ import annotations

from typing import NamedTuple

import mcap.records
import msgspec
import numpy as np
from numpy.typing import NDArray

from station.contract import Contract
from station.episode.storage import layout
from station.episode.storage.channels import contract_of
from station.episode.storage.pictures import DEPTH

Ints = NDArray[np.int64]


class Channel(msgspec.Struct, frozen=True, kw_only=True):
    """One key as one source wrote it.

    Attributes:
        id: Its number, which no other channel of the episode has.
        topic: The key.
        source: Full source of a native writer, "" for a foreign one.
        writer: Server name, or ``foreign``.
        encoding: ``json``, ``application/octet-stream``, ``application/x-deleted``, or ``protobuf`` for pictures, whose
            messages are handed out as the exact bytes of the key all the same, or as JPEG files made of their video.
        contract: The contract that was recorded with it, or None.
        file: Name of the file that its messages are in.
        video: Format of the video that its pictures were made into when the episode was compacted; "" for all others.
        is_placed: Whether times of writing of another machine are on the episode's clock all the same.
    """

    id: int
    topic: str
    source: str
    writer: str
    encoding: str
    contract: Contract | None
    file: str = layout.SIGNALS
    video: str = ""
    is_placed: bool = False

    @property
    def is_native(self) -> bool:
        """Whether its writer stamps what it writes."""
        return self.source != ""

    @property
    def is_bookkeeping(self) -> bool:
        """Whether it holds the recorder's own list of stamps, not a key of the bus of the same name."""
        return self.topic == layout.STAMPS_TOPIC and self.writer == layout.RECORDER and not self.source

    @property
    def is_typed(self) -> bool:
        """Whether the bytes of the key stand inside a typed message in the file."""
        return self.encoding == layout.PROTOBUF

    @property
    def is_depth(self) -> bool:
        """Whether it holds depth pictures, by the contract that was recorded with it."""
        return self.contract is not None and self.contract.codec == DEPTH

    @property
    def is_deletion(self) -> bool:
        """Whether its (empty) messages say that the key was deleted or expired."""
        return self.encoding == layout.DELETED


class Message(NamedTuple):
    """One write, byte for byte; a picture of a compacted episode as a JPEG file made of its video.

    Times are nanoseconds since the Unix epoch on the episode's clock: `log_ns` arrival at the recorder, `publish_ns`
    the writer's own time (equal to `log_ns` for a foreign writer). `sequence` is 32 bit: the writer's own count,
    or ours from 1 for a foreign one. `stamp` is the exact stamp of a native write, None unless it was asked for.
    """

    topic: str
    data: bytes
    log_ns: int
    publish_ns: int
    sequence: int
    channel: Channel
    stamp: bytes | None = None


class Vectors(NamedTuple):
    """The numbers of one key: times (k,) int64 [ns], and values (k, m) float64, float32 or int64 by its codec."""

    log_ns: Ints
    publish_ns: Ints
    values: NDArray[np.float64] | NDArray[np.float32] | NDArray[np.int64]


class StreamInfo(msgspec.Struct, frozen=True, kw_only=True):
    """A channel and what of it is in the file: number of messages, first and last arrival [ns] (0 when empty)."""

    channel: Channel
    count: int
    first_ns: int
    last_ns: int


def channel_of(record: mcap.records.Channel, *, file: str = layout.SIGNALS, first_id: int = 0) -> Channel:
    """Return what an MCAP channel record says; a contract that we cannot read counts as none.

    Args:
        record: The record.
        file: Name of its file.
        first_id: Where the numbers of its file begin.
    """
    metadata = record.metadata
    return Channel(
        id=first_id + record.id,
        topic=record.topic,
        source=metadata.get("source", ""),
        is_placed=layout.ON_EPISODE_CLOCK.items() <= metadata.items(),
        writer=metadata.get("writer", layout.FOREIGN),
        encoding=record.message_encoding,
        contract=contract_of(record),
        file=file,
        video=metadata.get(layout.VIDEO, ""),
    )
