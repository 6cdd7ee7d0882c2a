"""An episode taken apart and put together again with the plain MCAP library, as a stranger would who has read the docs.

What a recipe leaves alone stays byte for byte: messages, channels, attachments, records of metadata, and which messages
shared a chunk. The recorder lists the exact stamp of every write in a topic of its own, a line per message, at the end
of each chunk; here each message carries its line, and the list is made anew.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema
from mcap.records import Message as Record
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

SIGNALS, CAMERAS, MANIFEST = "signals.mcap", "cameras.mcap", "manifest.yaml"
STAMPS = "station:recorder:stamps"
ANCHOR = "station.anchor"
ONE_S = 1_000_000_000

_ENDLESS = 1 << 40  # bytes of a chunk that ends only where it is told to
_VECTORS = {"f64": "<f8", "f32": "<f4"}
_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


class DoesNotFit(Exception):
    """An episode has nothing that a recipe could spoil: no camera, no policy, nothing that moves."""


@dataclass(slots=True, eq=False)
class Message:
    """A message, and the line that tells the exact stamp of its write; None for a writer without stamps.

    Attributes:
        channel: Number of its channel in the file.
        sequence, log_ns, publish_ns, data: As in the file; times in nanoseconds since the epoch.
        stamp: ``seq mono_ns wall_ns source [capture_ns]``.
    """

    channel: int
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes
    stamp: bytes | None = None

    def move(self, ns: int, *, arrival: bool = False, captured_ns: int | None = None) -> None:
        """Say that it was written later by so many nanoseconds; that it arrived later too; when a picture was taken."""
        self.publish_ns += ns
        self.log_ns += ns if arrival else 0
        if self.stamp is not None:
            seq, mono, wall, source, *capture = self.stamp.split(b" ")
            taken = [b"%d" % (int(each) + (ns if captured_ns is None else captured_ns)) for each in capture]
            self.stamp = b" ".join([seq, b"%d" % (int(mono) + ns), b"%d" % (int(wall) + ns), source, *taken])

    def number(self, sequence: int) -> None:
        """Count it as another write of its writer."""
        if self.stamp is not None:
            self.stamp = b"%d %b" % (sequence, self.stamp.split(b" ", 1)[1])
        self.sequence = sequence & 0xFFFFFFFF

    def copy(self) -> Message:
        return Message(self.channel, self.sequence, self.log_ns, self.publish_ns, self.data, self.stamp)


class Recording:
    """One MCAP file in memory.

    Attributes:
        parts: What it holds, in file order: metadata, attachments, and chunks, which are lists of schemas, channels and
            messages.
        channels: By number.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.parts: list[Any] = []
        self._compression = CompressionType.ZSTD
        self._header = Header("", "")
        self._stamps_channel = 0
        with path.open("rb") as file:
            for record in StreamReader(file, emit_chunks=True, record_size_limit=None).records:
                if isinstance(record, Header):
                    self._header = record
                elif isinstance(record, Chunk):
                    self._compression = CompressionType.ZSTD if record.compression else CompressionType.NONE
                    self.parts.append(self._chunk(breakup_chunk(record)))
                elif isinstance(record, Metadata | Attachment):
                    self.parts.append(record)

    def metadata(self, name: str) -> dict[str, str]:
        return next(part.metadata for part in self.parts if isinstance(part, Metadata) and part.name == name)

    def attachments(self) -> list[Attachment]:
        return [part for part in self.parts if isinstance(part, Attachment)]

    def messages(self) -> Iterator[Message]:
        """Iterate over all messages, without the list of stamps, in file order."""
        for part in self.parts:
            if isinstance(part, list):
                yield from (item for item in part if isinstance(item, Message))

    def replace(self, change: Callable[[Message], Iterable[Message]]) -> None:
        """Put other messages in the place of each."""
        for number, part in enumerate(self.parts):
            if isinstance(part, list):
                self.parts[number] = [
                    made for item in part for made in (change(item) if isinstance(item, Message) else [item])
                ]

    def reorder(self, order: list[Message]) -> None:
        """Put all messages into another order; chunks hold as many as before."""
        following = iter(order)
        self.replace(lambda _: [next(following)])

    def write(self, path: Path, *, with_empty: bool) -> None:
        """Write it to a file; without what describes channels of no message, where a recorder would have made none."""
        used = {message.channel for message in self.messages()} | {self._stamps_channel}
        numbers: dict[int, int] = {}
        with path.open("wb") as file:
            writer = Writer(file, chunk_size=_ENDLESS, compression=self._compression)
            writer.start(self._header.profile, self._header.library)
            for part in self.parts:
                if isinstance(part, Metadata):
                    writer.add_metadata(part.name, part.metadata)
                elif isinstance(part, Attachment):
                    writer.add_attachment(part.create_time, part.log_time, part.name, part.media_type, part.data)
                else:
                    self._write_chunk(writer, part, numbers, None if with_empty else used)
            writer.finish()

    def _chunk(self, records: list[Any]) -> list[Any]:
        found: list[Any] = []
        stamps: Iterator[bytes] = iter(())
        for record in records:
            if isinstance(record, Channel):
                self.channels[record.id] = record
                self._stamps_channel = record.id if record.topic == STAMPS else self._stamps_channel
            if not isinstance(record, Record):
                found.append(record)
            elif record.channel_id == self._stamps_channel:
                stamps = iter(record.data.split(b"\n"))
                found.append(record)
            else:
                found.append(
                    Message(record.channel_id, record.sequence, record.log_time, record.publish_time, record.data)
                )
        for message in found:
            if isinstance(message, Message) and self.channels[message.channel].metadata.get("source"):
                number, _, stamp = next(stamps).partition(b" ")
                if int(number) != message.channel:
                    raise ValueError(f"{self.path}: a stamp of channel {number!r} beside channel {message.channel}")
                message.stamp = stamp
        return found

    def _write_chunk(self, writer: Writer, items: list[Any], numbers: dict[int, int], used: set[int] | None) -> None:
        if not any(isinstance(item, Message) for item in items):
            items = [item for item in items if not isinstance(item, Record)]  # nothing was written: no list of stamps
        stamps = []
        for item in items:
            if isinstance(item, Schema):
                writer.register_schema(item.name, item.encoding, item.data)
            elif isinstance(item, Channel):
                if used is None or item.id in used:
                    numbers[item.id] = writer.register_channel(
                        item.topic, item.message_encoding, item.schema_id, item.metadata
                    )
            elif isinstance(item, Message):
                number = numbers[item.channel]
                writer.add_message(number, item.log_ns, item.data, item.publish_ns, item.sequence)
                if item.stamp is not None:
                    stamps.append(b"%d %b" % (number, item.stamp))
            elif stamps:
                lines = b"\n".join(stamps)
                writer.add_message(numbers[item.channel_id], item.log_time, lines, item.publish_time, item.sequence)
        # A chunk is what the recorder has flushed at once; the library has no word of its own for "end it here".
        writer._Writer__finalize_chunk()


@dataclass
class Stream:
    """One key: its messages, whoever wrote them, and its contract.

    Attributes:
        key, contract, messages: The key; what its channel says that it holds; in file order.
        recording: Where it is.
    """

    key: str
    contract: dict[str, Any]
    messages: list[Message]
    recording: Recording

    @property
    def names(self) -> list[str]:
        return [element["name"] for element in self.contract.get("elements", ())]

    @property
    def units(self) -> list[str]:
        return [element["unit"] for element in self.contract.get("elements", ())]

    @property
    def role(self) -> str:
        return str(self.contract.get("role", ""))

    @property
    def source(self) -> str:
        return str(self.recording.channels[self.messages[0].channel].metadata.get("source", ""))

    @property
    def writer(self) -> str:
        return self.source.split(".", 1)[0]

    @property
    def is_vector(self) -> bool:
        return self.contract.get("codec") in (*_VECTORS, "json-vector")

    @property
    def times_ns(self) -> np.ndarray:
        """When each message arrived at the recorder [ns]."""
        return np.array([message.log_ns for message in self.messages])

    @property
    def values(self) -> np.ndarray:
        """Numbers of its messages, shape (n, m); a copy that `put` writes back."""
        codec = self.contract["codec"]
        if codec in _VECTORS:
            return np.array([np.frombuffer(one.data, _VECTORS[codec]) for one in self.messages], dtype=float)
        return np.array([json.loads(one.data) for one in self.messages], dtype=float)

    def put(self, values: np.ndarray) -> None:
        """Write numbers back, into those messages whose numbers are others than before."""
        codec = self.contract["codec"]
        for message, before, row in zip(self.messages, self.values, values, strict=True):
            if not np.array_equal(before, row, equal_nan=True):
                is_raw = codec in _VECTORS
                message.data = row.astype(_VECTORS[codec]).tobytes() if is_raw else json.dumps(row.tolist()).encode()

    def columns(self, wanted: Callable[[str], bool]) -> list[int]:
        return [index for index, name in enumerate(self.names) if wanted(name)]


class Episode:
    """The folder of an episode, to be spoiled and saved.

    Attributes:
        folder: A copy, of which nothing else is held.
        text: The manifest, as text.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.text = (folder / MANIFEST).read_text(encoding="utf-8")
        self._before = {name: facts for name in (SIGNALS, CAMERAS) if (facts := _facts(folder / name))}
        self._recordings: dict[str, Recording] = {}

    @property
    def signals(self) -> Recording:
        return self._recording(SIGNALS)

    @property
    def cameras(self) -> Recording:
        if CAMERAS not in self._before:
            raise DoesNotFit("no camera")
        return self._recording(CAMERAS)

    @property
    def start_ns(self) -> int:
        return int(self.signals.metadata(ANCHOR)["wall_ns"])

    @property
    def manifest(self) -> dict[str, Any]:
        return yaml.load(self.text, _LOADER)

    def at_s(self, log_ns: int) -> float:
        """Return an instant from the start of the episode [s]."""
        return float((log_ns - self.start_ns) / ONE_S)

    def streams(self, recording: Recording | None = None) -> dict[str, Stream]:
        """Return the keys of the signals, or of another file, that have messages."""
        recording = recording or self.signals
        by_topic: dict[str, list[Message]] = {}
        for message in recording.messages():
            by_topic.setdefault(recording.channels[message.channel].topic, []).append(message)
        return {
            topic: Stream(topic, _contract(recording.channels[messages[0].channel]), messages, recording)
            for topic, messages in by_topic.items()
        }

    def save(self, *, is_sealed: bool) -> None:
        """Write it back.

        Args:
            is_sealed: Whether the manifest, and its copy among the signals, shall agree with what the files hold now,
                as if the recorder itself had written this: counts, times and rates of streams, sizes, and any hash of
                a whole file. Else it stays as it was, as when somebody changes a file afterwards.
        """
        document = None
        if is_sealed and self._recordings:
            self._recording(SIGNALS)  # holds the copy of the manifest
            document = self._resealed(self.manifest)
            for attachment in self.signals.attachments():
                closed = yaml.load(attachment.data, _LOADER) if attachment.name == MANIFEST else None
                if closed and closed.get("streams"):
                    attachment.data = _dumped(self._resealed(closed)).encode()
        for name, recording in self._recordings.items():
            (self.folder / name).unlink()
            recording.write(self.folder / name, with_empty=not is_sealed)
        text = self.text
        if document is not None:
            after = {name: _facts(self.folder / name) for name in self._before}
            for name, before in self._before.items():
                _replace_facts(document, before, after[name])
            text = _dumped(document)
        (self.folder / MANIFEST).write_text(text, encoding="utf-8")

    def _recording(self, name: str) -> Recording:
        if name not in self._recordings:
            self._recordings[name] = Recording(self.folder / name)
        return self._recordings[name]

    def _resealed(self, document: dict[str, Any]) -> dict[str, Any]:
        rows = {name: _rows(recording, self.start_ns) for name, recording in self._recordings.items()}
        kept = []
        for row in document["streams"]:
            counted = rows.get(row["file"])
            if counted is None:
                kept.append(row)
            elif (found := counted.get((row["key"], row["source"]))) is not None:
                kept.append(row | found)
        count = sum(row["count"] for row in kept)
        before = sum(row["count"] for row in document["streams"])
        if document.get("recorder", {}).get("messages") == before:
            document["recorder"]["messages"] = count
        return document | {"streams": kept}


def _contract(channel: Channel) -> dict[str, Any]:
    text = channel.metadata.get("contract", "none")
    return {} if text == "none" else json.loads(text)


def _rows(recording: Recording, start_ns: int) -> dict[tuple[str, str], dict[str, Any]]:
    """Return what a manifest says of each stream of a file, by key and source."""
    found: dict[tuple[str, str], list[Message]] = {}
    for message in recording.messages():
        channel = recording.channels[message.channel]
        found.setdefault((channel.topic, channel.metadata.get("source", "")), []).append(message)
    return {name: _row(messages, start_ns) for name, messages in found.items()}


def _row(messages: list[Message], start_ns: int) -> dict[str, Any]:
    first, last = messages[0], messages[-1]
    lost = repeated = longest_ns = 0
    newest = first.sequence
    for before, message in pairwise(messages):
        step = message.sequence - newest
        lost, repeated = lost + max(0, step - 1), repeated + (step < 1)
        newest = max(newest, message.sequence)
        longest_ns = max(longest_ns, message.log_ns - before.log_ns)
    span_s = (last.log_ns - first.log_ns) / ONE_S
    several = len(messages) > 1
    return {
        "count": len(messages),
        "lost": lost,
        "repeated": repeated,
        "rate_hz": round((len(messages) - 1) / span_s, 3) if several and span_s > 0 else None,
        "longest_gap_s": round(longest_ns / ONE_S, 6) if several else None,
        "first_s": round((first.log_ns - start_ns) / ONE_S, 6),
        "last_s": round((last.log_ns - start_ns) / ONE_S, 6),
    }


def _facts(path: Path) -> dict[str, Any]:
    """Return what somebody may have noted of a whole file: hashes, as text, and its size."""
    if not path.exists():
        return {}
    data = path.read_bytes()
    hashes = ("sha256", "sha1", "md5", "sha512", "blake2b", "blake2s", "sha3_256")
    return {name: hashlib.new(name, data).hexdigest() for name in hashes} | {"size": len(data)}


def _replace_facts(node: Any, before: dict[str, Any], after: dict[str, Any]) -> None:
    """Put hashes and sizes of a file as it is now in the place of those before, wherever a document has them."""
    same = {before[name]: after.get(name, "") for name in before}
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for place, value in list(items):
        if isinstance(value, dict | list):
            _replace_facts(value, before, after)
        elif isinstance(value, str | int) and not isinstance(value, bool) and value in same:
            node[place] = same[value]


def _dumped(document: dict[str, Any]) -> str:
    return yaml.dump(document, Dumper=_DUMPER, sort_keys=False, allow_unicode=True, width=120)


def chunk_places(path: Path) -> list[tuple[int, int]]:
    """Return where the contents of each chunk of a file begin, and their length in bytes."""
    data, position, found = path.read_bytes(), 8, []
    while position + 9 <= len(data) - 8:
        opcode, length = data[position], int.from_bytes(data[position + 1 : position + 9], "little")
        if opcode == Opcode.CHUNK:
            name = int.from_bytes(data[position + 37 : position + 41], "little")
            begin = position + 41 + name + 8
            found.append((begin, position + 9 + length - begin))
        position += 9 + length
    return found
