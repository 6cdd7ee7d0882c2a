"""One MCAP file of an episode while it is written: exact bytes in, one chunk per flush. One thread at a time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mcap.records
from mcap.records import Metadata, Schema
from msgspec.structs import asdict

from station.bus import stamp as stamps
from station.bus.clocks import OffsetOf, unknown
from station.bus.contracts import Contracts
from station.bus.tap.base import Write
from station.episode.storage import bulk, layout
from station.episode.storage.anchor import Anchor, is_storable
from station.episode.storage.channels import MAX_CHANNELS, Channel, channel_from, encoding_of, source_of
from station.episode.storage.disk import Disk
from station.episode.storage.drops import Drops
from station.episode.storage.progress import Gap
from station.episode.storage.records import MAGIC, RawMessage
from station.episode.storage.tail import closing_bytes
from station.episode.writing.checkpoint import MOST_CHANNELS, Checkpoint, counters
from station.episode.writing.chunks import ChunkWriter, header, written_record
from station.episode.writing.salvage import Head, SalvageResult, salvage
from station.episode.writing.summary import EpisodeSummary, is_told
from station.errors import EpisodeError

_SEQUENCE_MASK = 0xFFFFFFFF
_LARGEST_SEQUENCE = 1 << 48  # nine thousand years at 1 kHz: what counts further is no stamp of ours
_BOOKKEEPING = {"source": "", "writer": "recorder", "contract": layout.NO_CONTRACT}

STAMPS_NUMBER = 1  # of the channel that holds the exact stamps
MOST_GAPS = 10_000  # beyond that only the counters go on


class FarTimes:
    """When other machines wrote, by an episode's clock.

    All values of one write have one instant, by which readers know that they belong together: what is known of a clock
    may have changed between two of them.

    Args:
        offset_of: How the clocks of other machines are to be read.
    """

    def __init__(self, offset_of: OffsetOf = unknown) -> None:
        self.offset_of = offset_of
        self._newest: dict[str, tuple[int, int]] = {}

    def at(self, source: str, written_ns: int, log_ns: int, anchor: Anchor) -> int:
        """Return when a source wrote a value; when it came, where its clock is not known [ns].

        Args:
            source: Who.
            written_ns: When, by the monotonic clock of its machine.
            log_ns: When the value came.
            anchor: The episode's clock.
        """
        if (newest := self._newest.get(source)) is not None and newest[0] == written_ns:
            return newest[1]
        offset = self.offset_of(stamps.boot_of(source))
        found = log_ns if offset is None else min(anchor.at(written_ns + offset.ns), log_ns)
        self._newest[source] = written_ns, found
        return found


class EpisodeFile:
    """``signals.mcap.active``, or that of pictures or clouds: turns writes into messages, and counts them per channel.

    Attributes:
        names: What it is called; in those of pictures and clouds chunks are not compressed, and values have a type.
        channels: Every channel so far, in order of appearance.
        messages: Messages in the file, flushed or not; the recorder's own bookkeeping is not counted.
        refused, drops: Writes that could not be kept, because there were too many channels; where they are counted.
        pending_bytes: Size of the values since the last flush.
        last_log_ns: Log time of the last message; of an empty file the start [ns].
        gaps: Where sequence numbers of a writer are missing; the first ones, if there are very many.
        episode_summary: What the messages tell.
        contracts: What is known of keys when their channels are made.
        far: When other machines wrote; nothing is known of their clocks until it is set.
    """

    def __init__(self, disk: Disk, anchor: Anchor, names: layout.Names, drops: Drops | None, *, is_new: bool) -> None:
        """Wrap a file that is open at its end; `create` and `reopen` make one."""
        self.names = names
        self.contracts = Contracts()
        self.far = FarTimes()
        self._anchor = anchor
        self._disk = disk
        self._by_stamp: dict[tuple[str, bytes], Channel] = {}
        self._foreign: dict[tuple[str, bool], Channel] = {}
        self._stamps: list[bytes] = []
        self._schemas: list[mcap.records.Schema] = []
        self._records: list[mcap.records.Channel] = []
        self.channels: list[Channel] = []
        self.gaps: list[Gap] = []
        self.episode_summary = EpisodeSummary(anchor)
        self._told: set[int] = set()  # channels that the retelling wants
        self.messages = self.refused = self.pending_bytes = self._synced_messages = 0
        self.last_log_ns = anchor.wall_ns
        self.drops = Drops() if drops is None else drops
        self._writer = ChunkWriter(disk, is_new=is_new, compression="zstd" if names is layout.SIGNALS_NAMES else "")

    @classmethod
    def create(
        cls, path: Path, anchor: Anchor, facts: Mapping[str, str], *, manifest: bytes = b"",
        names: layout.Names = layout.SIGNALS_NAMES, drops: Drops | None = None,
    ) -> EpisodeFile:  # fmt: skip
        """Create the file and put the clock, the facts and, where there is one, the manifest at its head.

        Raises:
            OSError: the disk refused it, or the file exists.
        """
        made = cls(Disk(path), anchor, names, drops, is_new=True)
        made._writer.start(layout.PROFILE)
        for name, told in _head_facts(anchor, facts).items():
            made._writer.write_metadata(name, told)
        if manifest:
            made._attach(layout.MANIFEST_START, manifest)
        made._register(layout.STAMPS_TOPIC, layout.TEXT, _BOOKKEEPING)
        made.sync()
        return made

    @classmethod
    def reopen(
        cls, path: Path, anchor: Anchor, *, size: int | None = None, checkpoint: Checkpoint | None = None,
        names: layout.Names = layout.SIGNALS_NAMES, drops: Drops | None = None,
    ) -> EpisodeFile:  # fmt: skip
        """Go on behind the last whole chunk of a file that was never finished; its counters are those of the file.

        Args:
            path, anchor: The file, and its clock. It is cut there; a second attempt after a crash finds the same.
            size: Go on behind this byte and nowhere else; None for wherever the last whole chunk ends.
            checkpoint: What is known of its first bytes; None has all of it read.
            names, drops: What it is called; what was dropped before that byte, None for nothing.

        Raises:
            OSError: the disk refused it.
            EpisodeError: it is damaged before `size`.
        """
        recount = Recount(anchor, checkpoint, names.final)
        start, known = (checkpoint.size, checkpoint.channels) if checkpoint else (len(MAGIC), [])
        found = salvage(path, recount.count, size=size, start=start, channels=[one.record for one in known])
        if size is not None and (found.kept_to != size or found.missing_indexes):
            raise EpisodeError(f"{path}: damaged at byte {found.kept_to} of {size} that were safe")
        made = cls(Disk(path, keep=found.kept_to), anchor, names, drops, is_new=False)
        if found.missing_indexes:
            made._disk.write(found.missing_indexes)
            made._disk.flush()
            made._disk.sync()
        made._adopt(found, recount)
        return made

    @property
    def path(self) -> Path:
        """Where it is."""
        return self._disk.path

    @property
    def size(self) -> int:
        """Bytes of the file that the system has."""
        return self._disk.written

    @property
    def unsynced_messages(self) -> int:
        """Messages that are not on the disk yet."""
        return self.messages - self._synced_messages

    def checkpoint(self) -> Checkpoint | None:
        """Return what is known of the file as far as it is flushed; None where that is too much."""
        if len(self.channels) > MOST_CHANNELS:
            return None
        known = {channel.id: channel for channel in self.channels}
        return Checkpoint(
            size=self.size,
            messages=self.messages,
            last_log_ns=self.last_log_ns,
            channels=[counters(record, known.get(record.id)) for record in self._records],
            gaps=self.gaps,
            told=self.episode_summary.told,
        )

    def add(self, write: Write, log_ns: int) -> None:
        """Put one write into the open chunk; its log time [ns since the epoch] `is_storable`."""
        key, value, stamp, _ = write
        self.last_log_ns = log_ns
        if stamp is not None and value is not None and self._add_native(key, value, stamp, log_ns):
            return
        self._add_foreign(key, value, log_ns)
        if stamp is not None:  # what stands beside the key is no stamp of ours, yet it was written: keep it
            self._add_foreign(key + "@", stamp, log_ns)

    def sync(self) -> None:
        """Close the chunk and wait until it is on the disk.

        Raises:
            OSError: the disk is full or gone.
        """
        if self._stamps:
            self._writer.add(STAMPS_NUMBER, 0, self.last_log_ns, self.last_log_ns, b"\n".join(self._stamps))
            self._stamps.clear()
        self._writer.end_chunk()
        self._disk.flush()
        self._disk.sync()
        self.pending_bytes = 0
        self._synced_messages = self.messages

    def write_metadata(self, name: str, facts: Mapping[str, str]) -> None:
        """Put a record of facts before the open chunk."""
        self._writer.write_metadata(name, dict(facts))

    def finish(self, summary: Mapping[str, str], manifest: bytes = b"") -> None:
        """Close the last chunk, add the summary and, where there is one, the closed manifest, and write the index.

        Raises:
            OSError: the disk is full or gone.
        """
        self.sync()
        if manifest:
            self._attach(layout.MANIFEST, manifest)
        self._writer.write_metadata(layout.SUMMARY_RECORD, dict(summary))
        if self._writer.is_indexed:
            self._writer.finish(self._schemas, self._records)
        else:
            self._disk.flush()
            self._disk.write(closing_bytes(self._disk.path, self._schemas, self._records))
        self._disk.flush()
        self._disk.sync()

    def close(self) -> None:
        """Release the file."""
        self._disk.close()

    def _attach(self, name: str, manifest: bytes) -> None:
        self._writer.attach(name, layout.MANIFEST_MEDIA_TYPE, manifest, self.last_log_ns)

    def _add_native(self, key: str, value: bytes, stamp: bytes, log_ns: int) -> bool:
        """Add a write with a stamp of ours; return False when it turns out to be none."""
        fields = stamp.split(b" ")
        channel = self._by_stamp.get((key, fields[3])) if len(fields) in (4, 5) else None
        if channel is None:
            channel = self._new_native(key, value, stamp)
            if channel is None:
                return False
        try:
            sequence = stamps.integer(fields[0])
            written_ns = stamps.integer(fields[1])
        except ValueError:
            return False
        if channel.shares_clock:
            publish_ns = self._anchor.at(written_ns)
        else:
            publish_ns = self.far.at(channel.source, written_ns, log_ns, self._anchor)
        if not is_storable(publish_ns) or b"\n" in stamp or abs(sequence) > _LARGEST_SEQUENCE:
            return False
        self._stamps.append(b"%d %b" % (channel.id, stamp))
        self._put(channel, sequence, value, log_ns, publish_ns, stamp)
        return True

    def _add_foreign(self, key: str, value: bytes | None, log_ns: int) -> None:
        channel = self._foreign.get((key, value is None))
        if channel is None:
            encoding = layout.DELETED if value is None else self._encoding(key, value)
            channel = self._new_channel(key, "", encoding)
            if channel is None:
                self.refused += 1
                self.drops.count(Write(key, value, None, 0), is_bulky=False)
                return
            self._foreign[key, value is None] = channel
        self._put(channel, channel.last_sequence + 1, value or b"", log_ns, log_ns)

    def _put(
        self, channel: Channel, sequence: int, value: bytes, log_ns: int, publish_ns: int, stamp: bytes | None = None
    ) -> None:
        before_ns = channel.last_ns
        if (lost := channel.count_message(sequence, log_ns)) and len(self.gaps) < MOST_GAPS:
            self.gaps.append(Gap(before_ns, log_ns, lost))
        number = sequence & _SEQUENCE_MASK
        if channel.encoding == layout.PROTOBUF:
            around = bulk.around(channel.key, len(value), publish_ns, stamp)
            self._writer.add(channel.id, number, log_ns, publish_ns, value, *around)
        else:
            self._writer.add(channel.id, number, log_ns, publish_ns, value)
        if channel.id in self._told:
            self.episode_summary.on_value(channel.key, value, log_ns)
        self.messages += 1
        self.pending_bytes += len(value) + 64

    def _new_native(self, key: str, value: bytes, stamp: bytes) -> Channel | None:
        if (source := source_of(stamp)) is None:
            return None
        channel = self._new_channel(key, source, self._encoding(key, value))
        if channel is not None:
            self._by_stamp[key, source.encode()] = channel
        return channel

    def _encoding(self, key: str, value: bytes) -> str:
        is_typed = self.names is bulk.names_of(key) and self.names is not layout.SIGNALS_NAMES
        return layout.PROTOBUF if is_typed else encoding_of(value)

    def _new_channel(self, key: str, source: str, encoding: str) -> Channel | None:
        if len(self.channels) >= MAX_CHANNELS:
            return None
        number = len(self.channels) + 1 + STAMPS_NUMBER
        channel = Channel(number, key, source, encoding, self.names.final, self.contracts.get(key))
        self._register(channel.topic, encoding, channel.metadata())
        self.channels.append(channel)
        return channel

    def _register(self, topic: str, encoding: str, metadata: dict[str, str]) -> int:
        number = len(self._records) + 1
        if is_told(topic, encoding):
            self._told.add(number)
        if encoding == layout.PROTOBUF and not self._schemas:
            self._describe(type_in(self.names))
        schema = self._schemas[0].id if encoding == layout.PROTOBUF else 0
        self._records.append(mcap.records.Channel(number, topic, encoding, metadata, schema))
        self._writer.define(self._records[-1])
        return number

    def _describe(self, schema: mcap.records.Schema) -> None:
        self._schemas.append(schema)
        self._writer.define(schema)

    def _adopt(self, found: SalvageResult, recount: Recount) -> None:
        """Adopt channels and counters of the file; a channel keeps its number, its count and what describes it."""
        for schema in found.schemas.values():
            self._describe(schema)
        first = mcap.records.Channel(STAMPS_NUMBER, layout.STAMPS_TOPIC, layout.TEXT, _BOOKKEEPING, 0)
        for number, record in sorted({STAMPS_NUMBER: first, **found.channels}.items()):
            if self._register(record.topic, record.message_encoding, record.metadata) != number:
                raise EpisodeError(f"{self._disk.path}: nothing describes its channel {len(self._records)}")
            if number == STAMPS_NUMBER:
                continue
            channel = recount.channels.get(number) or channel_from(record, self.names.final)
            self.channels.append(channel)
            if channel.source:
                self._by_stamp[channel.key, channel.source.encode()] = channel
            else:
                self._foreign[channel.key, channel.encoding == layout.DELETED] = channel
        self.gaps, self.episode_summary = recount.gaps, recount.episode_summary
        self.messages = self._synced_messages = recount.messages
        self.last_log_ns = recount.last_log_ns or self._anchor.wall_ns


def head_of(anchor: Anchor, facts: Mapping[str, str]) -> Head:
    """Return the records that stand at the head of a file with a clock and facts."""
    records = [Metadata(name=name, metadata=told) for name, told in _head_facts(anchor, facts).items()]
    return Head(written_record(header(layout.PROFILE)), b"".join(map(written_record, records)))


def _head_facts(anchor: Anchor, facts: Mapping[str, str]) -> dict[str, dict[str, str]]:
    clock = {name: str(value) for name, value in asdict(anchor).items()}
    return {layout.ANCHOR_RECORD: clock, layout.EPISODE_RECORD: dict(facts)}


def type_in(names: layout.Names) -> Schema:
    """Return the description of what is in a file of pictures or clouds."""
    from station.protobuf import foxglove, schema  # 30 ms and 7 MB, of which a station without cameras needs nothing

    made = foxglove.schema(foxglove.POINT_CLOUD if names is layout.CLOUDS_NAMES else foxglove.COMPRESSED_IMAGE)
    return Schema(id=1, name=made.name, encoding=schema.ENCODING, data=made.data)


class Recount:
    """Takes the messages of a file in order; begins with what is known of it, if anything is.

    Attributes:
        channels, gaps, messages, episode_summary: As in `station.episode.writing.file.EpisodeFile`.
        last_log_ns: Log time of the last message [ns].
    """

    def __init__(self, anchor: Anchor, known: Checkpoint | None, file: str = layout.SIGNALS) -> None:
        self._file = file
        self.episode_summary = EpisodeSummary(anchor, known.told if known else None)
        self.channels: dict[int, Channel] = {}
        self.gaps: list[Gap] = []
        self.messages = self.last_log_ns = 0
        if known is not None:
            self.channels = {one.id: one.channel(file) for one in known.channels if one.id != STAMPS_NUMBER}
            self.gaps, self.messages, self.last_log_ns = known.gaps, known.messages, known.last_log_ns

    def count(self, message: RawMessage, record: mcap.records.Channel) -> None:
        """Count a message."""
        self.last_log_ns = message.log_ns
        self.episode_summary.on_message(message, record)
        channel = self.channels.get(message.channel_id)
        if channel is None:
            if record.topic == layout.STAMPS_TOPIC:
                return
            channel = self.channels[message.channel_id] = channel_from(record, self._file)
        before_ns = channel.last_ns
        if (lost := channel.count_message(message.sequence, message.log_ns)) and len(self.gaps) < MOST_GAPS:
            self.gaps.append(Gap(before_ns, message.log_ns, lost))
        self.messages += 1
