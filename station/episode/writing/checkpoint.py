"""What a recorder knows of its files so far, saved every few seconds, so that the next need not read it all again.

The files alone say the same, and without a checkpoint they are asked. But reading takes seconds for each gigabyte, and
all the while the bus server holds back what is written, which it does not for ever.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mcap.records
import msgspec

from station.atomic_file import refuse_special, write_atomic
from station.episode.storage import layout
from station.episode.storage.channels import Channel, channel_from
from station.episode.storage.manifest import Event, Mark, QualityFlags
from station.episode.storage.progress import Gap
from station.episode.storage.request import RecordRequest

EVERY_S = 5.0
MOST_CHANNELS = 5000  # of a client that invents keys without end, nothing is saved


class SummaryState(msgspec.Struct, kw_only=True):
    """What the messages of a file have told so far, as `station.episode.writing.summary.EpisodeSummary` gathers it.

    Attributes:
        events, events_not_listed, marks, motions, quality_flags, servers: As in the manifest.
        not_mirrored, not_mirrored_by: As in the manifest's `Recorder`.
        requests: Ids of the requests to the recorder in the file, in order.
        shortened: As in the manifest, for those of its sections.
        ending: The request that ended the episode, when it is in the file.
    """

    events: list[Event] = []
    events_not_listed: int = 0
    marks: list[Mark] = []
    motions: list[dict[str, Any]] = []
    quality_flags: QualityFlags = msgspec.field(default_factory=QualityFlags)
    servers: dict[str, dict[str, Any]] = {}
    not_mirrored: int = 0
    not_mirrored_by: dict[str, int] = {}
    requests: list[str] = []
    shortened: dict[str, int] = {}
    ending: RecordRequest | None = None


class Counters(msgspec.Struct, frozen=True, kw_only=True):
    """A channel as the file describes it, and its counters, as in `station.episode.storage.channels.Channel`."""

    id: int
    topic: str
    encoding: str
    metadata: dict[str, str]
    count: int = 0
    lost: int = 0
    repeated: int = 0
    last_sequence: int = 0
    first_ns: int = 0
    last_ns: int = 0
    longest_gap_ns: int = 0

    @property
    def record(self) -> mcap.records.Channel:
        """The channel as it stands in the file."""
        return mcap.records.Channel(self.id, self.topic, self.encoding, self.metadata, 0)

    def channel(self, file: str) -> Channel:
        """Return the channel with its counters; `file` is the name of the file that it is in."""
        channel = channel_from(self.record, file)
        for name in _COUNTERS:
            setattr(channel, name, getattr(self, name))
        return channel


_COUNTERS = ("count", "lost", "repeated", "last_sequence", "first_ns", "last_ns", "longest_gap_ns")


class Checkpoint(msgspec.Struct, frozen=True, kw_only=True):
    """Everything about the first `size` bytes of a file.

    Attributes:
        size: Length of the file up to the end of a flush.
        messages, last_log_ns: Messages in it, and the log time of the last one [ns].
        channels: Every channel, in the order of their numbers, the one of the stamps among them.
        gaps: Where sequence numbers are missing.
        told: What the messages say.
    """

    size: int
    messages: int
    last_log_ns: int
    channels: list[Counters]
    gaps: list[Gap]
    told: SummaryState


def counters(record: mcap.records.Channel, channel: Channel | None) -> Counters:
    """Return what a checkpoint says of a channel; that of the stamps has no counters."""
    found = {name: getattr(channel, name) for name in _COUNTERS} if channel is not None else {}
    return Counters(
        id=record.id, topic=record.topic, encoding=record.message_encoding, metadata=dict(record.metadata), **found
    )


def save_checkpoints(checkpoints: Mapping[str, Checkpoint], folder: Path) -> None:
    """Write a checkpoint of each file, by its name; survives the death of the process, not that of the machine.

    Raises:
        OSError: the disk refused it.
    """
    write_atomic(folder / layout.CHECKPOINT, msgspec.json.encode(checkpoints), sync=False)


def load_checkpoint(folder: Path, file: str, size: int) -> Checkpoint | None:
    """Return the checkpoint of a file of an episode, of which `size` bytes are safe; None where none fits."""
    try:
        refuse_special(folder / layout.CHECKPOINT)
        found = msgspec.json.decode((folder / layout.CHECKPOINT).read_bytes(), type=dict[str, Checkpoint]).get(file)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
    return found if found is not None and found.size <= size else None
