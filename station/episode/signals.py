"""The MCAP file of an episode while it is written: exact bytes in, one chunk per flush. One thread at a time."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from mcap.writer import CompressionType, Writer

from station.episode import layout
from station.episode.anchor import Anchor, is_storable
from station.episode.atomic import write_all
from station.episode.channels import MAX_CHANNELS, Channel, encoding_of, source_of

if TYPE_CHECKING:
    from station.bus.tap import Write

_NO_LIMIT = 1 << 62  # the library must not cut chunks itself: one chunk is one flush, with the stamps of its messages
_SEQUENCE_MASK = 0xFFFFFFFF


class Disk:
    """The output of the MCAP library: collects, and writes everything in one call when flushed.

    So a failing disk shows in `flush` only, and a process killed between two flushes leaves whole chunks.
    """

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._parts: list[bytes] = []
        self._position = 0
        self.written = 0

    def write(self, data: bytes) -> int:
        """Keep bytes until the next flush."""
        if data:
            self._parts.append(data)
            self._position += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the position that the next byte will have."""
        return self._position

    def flush(self) -> None:
        """Hand everything to the system.

        Raises:
            OSError: the disk is full or gone; what of this flush was written is cut off again where possible.
        """
        data = b"".join(self._parts)
        self._parts.clear()
        try:
            write_all(self._descriptor, data)
        except OSError:
            os.ftruncate(self._descriptor, self.written)
            raise
        self.written += len(data)

    def sync(self) -> None:
        """Wait until the data are on the disk."""
        os.fdatasync(self._descriptor)

    def close(self) -> None:
        """Release the file; what was not flushed is lost."""
        os.close(self._descriptor)


class SignalsFile:
    """``signals.mcap.active``: turns writes into messages, and counts them per channel.

    Attributes:
        channels: Every channel so far, in order of appearance.
        messages: Messages in the file, flushed or not; the recorder's own bookkeeping is not counted.
        refused: Writes that could not be kept, because there were too many channels.
        pending_bytes: Size of the values since the last flush.
    """

    def __init__(self, path: Path, anchor: Anchor, facts: Mapping[str, str], manifest: bytes) -> None:
        """Create the file and put the clock, the facts and the manifest at its head.

        Raises:
            OSError: the disk refused it, or the file exists.
        """
        self._anchor = anchor
        self._disk = Disk(path)
        self._by_stamp: dict[tuple[str, bytes], Channel] = {}
        self._foreign: dict[tuple[str, bool], Channel] = {}
        self._stamps: list[bytes] = []
        self._last_log_ns = anchor.wall_ns
        self.channels: list[Channel] = []
        self.messages = self.refused = self.pending_bytes = self._synced_messages = 0
        self._writer = Writer(self._disk, chunk_size=_NO_LIMIT, compression=CompressionType.ZSTD)
        self._writer.start(layout.PROFILE, library="teleop-station")
        clock = {"wall_ns": str(anchor.wall_ns), "mono_ns": str(anchor.mono_ns), "boot": anchor.boot}
        self._writer.add_metadata(layout.ANCHOR_RECORD, clock)
        self._writer.add_metadata(layout.EPISODE_RECORD, dict(facts))
        self._attach(manifest)
        self._stamps_channel = self._writer.register_channel(
            layout.STAMPS_TOPIC, layout.TEXT, 0, {"source": "", "writer": "recorder", "contract": layout.NO_CONTRACT}
        )
        self.sync()

    @property
    def size(self) -> int:
        """Bytes of the file that the system has."""
        return self._disk.written

    @property
    def unsynced_messages(self) -> int:
        """Messages that are not on the disk yet."""
        return self.messages - self._synced_messages

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
            self._writer.add_message(self._stamps_channel, log_ns, b"\n".join(self._stamps), log_ns)
            self._stamps.clear()
        self._writer.flush()
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
        self._writer.add_metadata(layout.SUMMARY_RECORD, dict(summary))
        self._writer.finish()
        self._disk.flush()
        self._disk.sync()

    def close(self) -> None:
        """Release the file."""
        self._disk.close()

    def _attach(self, manifest: bytes) -> None:
        now = self._last_log_ns
        self._writer.add_attachment(now, now, layout.MANIFEST, layout.MANIFEST_MEDIA_TYPE, manifest)

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
                return
            self._foreign[key, value is None] = channel
        self._put(channel, channel.last_sequence + 1, value or b"", log_ns, log_ns)

    def _put(self, channel: Channel, sequence: int, value: bytes, log_ns: int, publish_ns: int) -> None:
        channel.note(sequence, log_ns)
        self._writer.add_message(channel.id, log_ns, value, publish_ns, sequence & _SEQUENCE_MASK)
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
        channel = Channel(len(self.channels) + 2, key, source, encoding)  # the stamps have number 1
        number = self._writer.register_channel(channel.topic, encoding, 0, channel.metadata())
        if number != channel.id:
            raise RuntimeError(f"MCAP channel {number}, expected {channel.id}")
        self.channels.append(channel)
        return channel
