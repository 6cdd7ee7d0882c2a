"""The MCAP file of an episode while it is written: exact bytes in, one chunk per flush. One thread at a time."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path

import mcap.records

from station.bus.tap.base import Write
from station.episode.storage import layout
from station.episode.storage.anchor import Anchor, is_storable
from station.episode.storage.channels import MAX_CHANNELS, Channel, channel_from, encoding_of, source_of
from station.episode.storage.disk import Disk
from station.episode.storage.drops import Drops, drops_record, streams_of
from station.episode.storage.progress import Gap, Totals
from station.episode.storage.tail import closing_bytes
from station.episode.writing.checkpoint import MOST_CHANNELS, Checkpoint, counters
from station.episode.writing.chunks import ChunkWriter
from station.episode.writing.lag import Lag
from station.episode.writing.recount import MOST_GAPS, STAMPS_NUMBER, Recount
from station.episode.writing.retell import Retelling, is_told
from station.episode.writing.salvage import salvage
from station.errors import EpisodeError

_SEQUENCE_MASK = 0xFFFFFFFF
_BOOKKEEPING = {"source": "", "writer": "recorder", "contract": layout.NO_CONTRACT}
_DROPS_EVERY_S = 5.0  # a power cut may take so much of the counts of dropped writes; a kill takes none


class SignalsFile:
    """``signals.mcap.active``: turns writes into messages, and counts them per channel.

    Attributes:
        channels: Every channel so far, in order of appearance.
        messages: Messages in the file, flushed or not; the recorder's own bookkeeping is not counted.
        refused: Writes that could not be kept, because there were too many channels.
        drops: Writes that belong before the end of the file and are not in it, those that were refused among them.
        pending_bytes: Size of the values since the last flush.
        gaps: Where sequence numbers of a writer are missing; the first ones, if there are very many.
        retelling: What the messages tell.
    """

    def __init__(self, disk: Disk, anchor: Anchor, *, is_new: bool) -> None:
        """Take a file that is open at its end; `create` and `reopen` make one."""
        self._anchor = anchor
        self._disk = disk
        self._by_stamp: dict[tuple[str, bytes], Channel] = {}
        self._foreign: dict[tuple[str, bool], Channel] = {}
        self._stamps: list[bytes] = []
        self._last_log_ns = anchor.wall_ns
        self._records: list[mcap.records.Channel] = []
        self.channels: list[Channel] = []
        self.gaps: list[Gap] = []
        self.retelling = Retelling(anchor)
        self._told: set[int] = set()  # channels that the retelling wants
        self.messages = self.refused = self.pending_bytes = self._synced_messages = 0
        self.drops = Drops()
        self._noted_drops, self._drops_due = 0, 0.0
        self._writer = ChunkWriter(disk, is_new=is_new)

    @classmethod
    def create(cls, path: Path, anchor: Anchor, facts: Mapping[str, str], manifest: bytes) -> SignalsFile:
        """Create the file and put the clock, the facts and the manifest at its head.

        Raises:
            OSError: the disk refused it, or the file exists.
        """
        made = cls(Disk(path), anchor, is_new=True)
        made._writer.start(layout.PROFILE)
        clock = {"wall_ns": str(anchor.wall_ns), "mono_ns": str(anchor.mono_ns), "boot": anchor.boot}
        made._writer.note(layout.ANCHOR_RECORD, clock)
        made._writer.note(layout.EPISODE_RECORD, dict(facts))
        made._attach(manifest)
        made._register(layout.STAMPS_TOPIC, layout.TEXT, _BOOKKEEPING)
        made.sync()
        return made

    @classmethod
    def reopen(
        cls, path: Path, anchor: Anchor, *, size: int | None = None, checkpoint: Checkpoint | None = None,
        drops: Drops | None = None,
    ) -> SignalsFile:  # fmt: skip
        """Go on behind the last whole chunk of a file that was never finished; its counters are those of the file.

        Args:
            path: The file. It is cut there; a second attempt after a crash in between finds the same.
            anchor: Its clock.
            size: Go on behind this byte and nowhere else; None for wherever the last whole chunk ends.
            checkpoint: What is known of its first bytes; None has all of it read.
            drops: What was dropped before that byte; None for nothing.

        Raises:
            OSError: the disk refused it.
            EpisodeError: it is damaged before `size`.
        """
        recount = Recount(anchor, checkpoint)
        if checkpoint is None:
            found = salvage(path, recount.take, size=size)
        else:
            known = (counted.record for counted in checkpoint.channels)
            found = salvage(path, recount.take, size=size, start=checkpoint.size, channels=known)
        if size is not None and (found.kept_to != size or found.missing_indexes):
            raise EpisodeError(f"{path}: damaged at byte {found.kept_to} of {size} that were safe")
        made = cls(Disk(path, keep=found.kept_to), anchor, is_new=False)
        made.drops = drops or Drops()
        if found.missing_indexes:
            made._disk.write(found.missing_indexes)
            made._disk.flush()
            made._disk.sync()
        made._adopt(found.channels, recount)
        return made

    @property
    def size(self) -> int:
        """Bytes of the file that the system has."""
        return self._disk.written

    @property
    def unsynced_messages(self) -> int:
        """Messages that are not on the disk yet."""
        return self.messages - self._synced_messages

    def totals(self, dropped: int = 0, lag: Lag | None = None) -> Totals:
        """Return the counters; `dropped` writes never came here, and `lag` is the writer's."""
        counted = [channel for channel in self.channels if channel.count]
        return Totals(
            messages=self.messages,
            bytes=self.size,
            dropped=dropped + self.refused,
            first_ns=min((channel.first_ns for channel in counted), default=0),
            last_ns=max((channel.last_ns for channel in counted), default=0),
            streams=streams_of(list(self.channels), self.drops, self._anchor.wall_ns),
            gaps=list(self.gaps),
            lag_p50_ms=lag.percentile_ms(50) if lag else None,
            lag_p99_ms=lag.percentile_ms(99) if lag else None,
        )

    def checkpoint(self) -> Checkpoint | None:
        """Return what is known of the file as far as it is flushed; None where that is too much."""
        if len(self.channels) > MOST_CHANNELS:
            return None
        known = {channel.id: channel for channel in self.channels}
        return Checkpoint(
            size=self.size,
            messages=self.messages,
            last_log_ns=self._last_log_ns,
            channels=[counters(record, known.get(record.id)) for record in self._records],
            gaps=self.gaps,
            told=self.retelling.told,
        )

    def add(self, write: Write) -> None:
        """Put one write into the open chunk."""
        key, value, stamp, mono_ns = write
        log_ns = self._anchor.at(mono_ns)
        if not is_storable(log_ns):
            log_ns = self._last_log_ns
        self._last_log_ns = log_ns
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
            log_ns = self._last_log_ns
            self._writer.add(STAMPS_NUMBER, 0, log_ns, log_ns, b"\n".join(self._stamps))
            self._stamps.clear()
        if self.drops.total > self._noted_drops and time.monotonic() >= self._drops_due:
            self._note_drops()
        self._writer.end_chunk()
        self._disk.flush()
        self._disk.sync()
        self.pending_bytes = 0
        self._synced_messages = self.messages

    def finish(self, manifest: bytes, summary: Mapping[str, str]) -> None:
        """Close the last chunk, add the closed manifest and the summary, and write the index.

        Raises:
            OSError: the disk is full or gone.
        """
        self.sync()
        self._attach(manifest)
        if self.drops.total:
            self._note_drops()
        self._writer.note(layout.SUMMARY_RECORD, dict(summary))
        if self._writer.is_indexed:
            self._writer.finish(self._records)
        else:
            self._disk.flush()
            self._disk.write(closing_bytes(self._disk.path, self._records))
        self._disk.flush()
        self._disk.sync()

    def close(self) -> None:
        """Release the file."""
        self._disk.close()

    def _attach(self, manifest: bytes) -> None:
        self._writer.attach(layout.MANIFEST, layout.MANIFEST_MEDIA_TYPE, manifest, self._last_log_ns)

    def _note_drops(self) -> None:
        self._writer.note(layout.DROPPED_RECORD, drops_record(self.drops))
        self._noted_drops, self._drops_due = self.drops.total, time.monotonic() + _DROPS_EVERY_S

    def _add_native(self, key: str, value: bytes, stamp: bytes, log_ns: int) -> bool:
        """Add a write with a stamp of ours; return False when it turns out to be none."""
        fields = stamp.split(b" ")
        channel = self._by_stamp.get((key, fields[3])) if len(fields) in (4, 5) else None
        if channel is None:
            channel = self._new_native(key, value, stamp)
            if channel is None:
                return False
        try:
            sequence, written_ns = int(fields[0]), int(fields[1] if channel.shares_clock else fields[2])
        except ValueError:
            return False
        publish_ns = self._anchor.at(written_ns) if channel.shares_clock else written_ns
        if not is_storable(publish_ns) or b"\n" in stamp:
            return False
        self._stamps.append(b"%d %b" % (channel.id, stamp))
        self._put(channel, sequence, value, log_ns, publish_ns)
        return True

    def _add_foreign(self, key: str, value: bytes | None, log_ns: int) -> None:
        channel = self._foreign.get((key, value is None))
        if channel is None:
            encoding = layout.DELETED if value is None else encoding_of(value)
            channel = self._new_channel(key, "", encoding)
            if channel is None:
                self.refused += 1
                self.drops.note(Write(key, value, None, 0), is_bulky=False)
                return
            self._foreign[key, value is None] = channel
        self._put(channel, channel.last_sequence + 1, value or b"", log_ns, log_ns)

    def _put(self, channel: Channel, sequence: int, value: bytes, log_ns: int, publish_ns: int) -> None:
        before_ns = channel.last_ns
        if (lost := channel.note(sequence, log_ns)) and len(self.gaps) < MOST_GAPS:
            self.gaps.append(Gap(before_ns, log_ns, lost))
        self._writer.add(channel.id, sequence & _SEQUENCE_MASK, log_ns, publish_ns, value)
        if channel.id in self._told:
            self.retelling.note(channel.key, value, log_ns)
        self.messages += 1
        self.pending_bytes += len(value) + 64

    def _new_native(self, key: str, value: bytes, stamp: bytes) -> Channel | None:
        source = source_of(stamp)
        if source is None:
            return None
        channel = self._new_channel(key, source, encoding_of(value))
        if channel is not None:
            self._by_stamp[key, source.encode()] = channel
        return channel

    def _new_channel(self, key: str, source: str, encoding: str) -> Channel | None:
        if len(self.channels) >= MAX_CHANNELS:
            return None
        channel = Channel(len(self.channels) + 1 + STAMPS_NUMBER, key, source, encoding)
        self._register(channel.topic, encoding, channel.metadata())
        self.channels.append(channel)
        return channel

    def _register(self, topic: str, encoding: str, metadata: dict[str, str]) -> int:
        number = len(self._records) + 1
        if is_told(topic, encoding):
            self._told.add(number)
        self._records.append(mcap.records.Channel(number, topic, encoding, metadata, 0))
        self._writer.define(self._records[-1])
        return number

    def _adopt(self, records: Mapping[int, mcap.records.Channel], recount: Recount) -> None:
        """Take over channels and counters of the file; a channel keeps its number, its count and what describes it."""
        first = mcap.records.Channel(STAMPS_NUMBER, layout.STAMPS_TOPIC, layout.TEXT, _BOOKKEEPING, 0)
        for number, record in sorted({STAMPS_NUMBER: first, **records}.items()):
            if self._register(record.topic, record.message_encoding, record.metadata) != number:
                raise EpisodeError(f"{self._disk.path}: nothing describes its channel {len(self._records)}")
            if number == STAMPS_NUMBER:
                continue
            channel = recount.channels.get(number) or channel_from(record)
            self.channels.append(channel)
            if channel.source:
                self._by_stamp[channel.key, channel.source.encode()] = channel
            else:
                self._foreign[channel.key, channel.encoding == layout.DELETED] = channel
        self.gaps, self.retelling = recount.gaps, recount.retelling
        self.messages = self._synced_messages = recount.messages
        self._last_log_ns = recount.last_log_ns or self._anchor.wall_ns
