"""Reading an episode: its streams, its messages in order, its vectors as arrays; also of a torn or unfinished file."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, Literal

import msgspec

from station.bus import codec
from station.episode.reading.messages import Channel, Message, StreamInfo, Vectors, channel_of
from station.episode.reading.vectors import numbers
from station.episode.storage import layout
from station.episode.storage.anchor import Anchor
from station.episode.storage.drops import Drops, drops_of
from station.episode.storage.folder import resolve, signals_file
from station.episode.storage.manifest import Manifest, load_manifest, parse_manifest
from station.episode.storage.records import ChunkPlace, Contents, parse_chunk, read_chunk, walk
from station.errors import EpisodeError

__all__ = ["Channel", "EpisodeReader", "Message", "Order", "StreamInfo", "Vectors", "open_episode"]

Order = Literal["file", "log"]
_DIGITS = 20  # of a channel's number, which has 16 bits


class EpisodeReader:
    """An episode on disk. Opens, reads and closes the file within each call; holds nothing open in between.

    Attributes:
        folder: Folder of the episode.
        path: The MCAP file: ``signals.mcap``, or ``signals.mcap.active`` when it was never finished.
        manifest: From ``manifest.yaml``, else from the attachment in the MCAP file.
        anchor: Clock of the log times, or None when the file does not say.
        is_active: Whether the file was never finished.
        torn: One line that says what was cut off, or None for a whole file.
        skipped: After `vectors`: number of values per topic that did not fit their contract.
    """

    def __init__(self, path: Path) -> None:
        """Open by the path of the MCAP file.

        Raises:
            EpisodeError: cannot be read, or is no recording of ours.
        """
        self.path = path
        self.folder = path.parent
        self._contents = walk(path)
        if self._contents.profile != layout.PROFILE:
            raise EpisodeError(
                f"{path}: an MCAP file, but not a recording of this station "
                f"(profile {self._contents.profile!r}, expected {layout.PROFILE!r})"
            )
        self.is_active = path.name == layout.ACTIVE or not self._contents.is_finished
        self.torn = _torn(self._contents)
        self.anchor = _anchor(self._contents)
        self.manifest = self._read_manifest()
        self.skipped: dict[str, int] = {}
        self._streams: list[StreamInfo] | None = None

    @property
    def episode_id(self) -> str:
        """The episode's id."""
        return self.manifest.episode_id or self._contents.metadata.get(layout.EPISODE_RECORD, {}).get("episode_id", "")

    def streams(self) -> list[StreamInfo]:
        """Return every channel with its message count, by topic; the recorder's own bookkeeping is left out."""
        if self._streams is None:
            found: dict[int, tuple[Channel, int, int, int]] = {}
            for message in self._in_file_order(None):
                channel = message.channel
                _, count, first_ns, last_ns = found.get(channel.id) or (channel, 0, message.log_ns, message.log_ns)
                times = min(first_ns, message.log_ns), max(last_ns, message.log_ns)
                found[channel.id] = (channel, count + 1, *times)
            self._streams = sorted(
                (StreamInfo(channel=c, count=n, first_ns=first, last_ns=last) for c, n, first, last in found.values()),
                key=lambda stream: (stream.channel.topic, stream.channel.id),
            )
        return self._streams

    def topics(self) -> list[str]:
        """Return every key that has messages, sorted."""
        return sorted({stream.channel.topic for stream in self.streams()})

    def messages(
        self, topics: Collection[str] | None = None, *, order: Order = "file", stamps: bool = False
    ) -> Iterator[Message]:
        """Iterate over messages, all or those of some topics.

        Args:
            topics: Keys; None for all.
            order: ``file`` is the order of arrival at the recorder; ``log`` sorts by log time, stable.
            stamps: Whether to join the exact stamp to each native message.

        Raises:
            EpisodeError: a chunk in the middle of the file is damaged.
        """
        wanted = None if topics is None else frozenset(topics)
        if stamps:
            found = _join_stamps(self._in_file_order(None, bookkeeping=True))
            in_order: Iterator[Message] = (m for m in found if wanted is None or m.topic in wanted)
            return in_order if order == "file" else iter(sorted(in_order, key=_log_ns))
        return self._in_file_order(wanted) if order == "file" else self._in_log_order(wanted)

    def collect(self, topics: Collection[str]) -> dict[str, list[Message]]:
        """Return the messages of some topics in file order, in one pass; a topic without messages has an empty list."""
        found: dict[str, list[Message]] = {topic: [] for topic in topics}
        for message in self.messages(topics):
            found[message.topic].append(message)
        return found

    def vectors(self, topic: str, *, source: str | None = None) -> Vectors:
        """Return the numbers of a topic as arrays, decoded by its recorded contract.

        Values that do not fit (not a vector, other length, not finite for JSON) are left out and counted in
        `skipped`. A topic without messages gives arrays of length 0.

        Raises:
            EpisodeError: the topic has no contract, or one that holds no numbers.
        """
        messages = self.collect([topic])[topic]
        if source is not None:
            messages = [message for message in messages if message.channel.source == source]
        vectors, self.skipped[topic] = numbers(topic, messages)
        return vectors

    def json(self, topic: str) -> list[tuple[int, object]]:
        """Return (log_ns, decoded value) of every message of a JSON topic; `skipped` counts the undecodable."""
        found: list[tuple[int, object]] = []
        self.skipped[topic] = 0
        for message in self.messages([topic]):
            try:
                found.append((message.log_ns, codec.parse_json(message.data)))
            except codec.BadValue:
                self.skipped[topic] += not message.channel.is_deletion
        return found

    def attachments(self) -> dict[str, bytes]:
        """Return the attachments of the file by name, the last of each name."""
        return dict(self._contents.attachments)

    def metadata(self) -> dict[str, dict[str, str]]:
        """Return the metadata records of the file by name, the last of each name."""
        return dict(self._contents.metadata)

    def drops(self) -> Drops:
        """Return what the recorder dropped, as the file itself says; of an unfinished one that may be seconds old."""
        return drops_of(self._contents.metadata.get(layout.DROPPED_RECORD))

    def _read_manifest(self) -> Manifest:
        file = self.folder / layout.MANIFEST
        inside = self._contents.attachments.get(layout.MANIFEST)
        if file.exists() or inside is None:
            return load_manifest(file)
        return parse_manifest(inside, f"{self.path}, attachment {layout.MANIFEST}")

    def _in_file_order(self, topics: frozenset[str] | None, *, bookkeeping: bool = False) -> Iterator[Message]:
        for _, messages in self._chunks(self._contents.chunks, topics, bookkeeping=bookkeeping):
            yield from messages

    def _in_log_order(self, topics: frozenset[str] | None) -> Iterator[Message]:
        """Merge chunks that overlap in time; holds no more than those in memory."""
        waiting: list[Message] = []
        places = sorted(self._contents.chunks, key=lambda place: place.start_ns)
        for place, messages in self._chunks(places, topics):
            ready = next((i for i, message in enumerate(waiting) if message.log_ns >= place.start_ns), len(waiting))
            yield from waiting[:ready]
            waiting = sorted([*waiting[ready:], *messages], key=_log_ns)
        yield from waiting

    def _chunks(
        self, places: Iterable[ChunkPlace], topics: frozenset[str] | None, *, bookkeeping: bool = False
    ) -> Iterator[tuple[ChunkPlace, list[Message]]]:
        """Read chunk by chunk; yields each one's messages of the wanted topics."""
        records = dict(self._contents.channels)
        wanted: dict[int, Channel | None] = {}

        def choose(number: int) -> Channel | None:
            record = records.get(number)
            if record is None:
                raise EpisodeError(f"{self.path}: a message of channel {number}, which nothing describes")
            channel = channel_of(record)
            is_chosen = bookkeeping if channel.is_bookkeeping else (topics is None or record.topic in topics)
            wanted[number] = channel if is_chosen else None
            return wanted[number]

        with self.path.open("rb") as file:
            for place in places:
                found: list[Message] = []
                for number, sequence, log_ns, publish_ns, data in parse_chunk(self._read(file, place), records):
                    channel = wanted[number] if number in wanted else choose(number)
                    if channel is not None:
                        found.append(Message(channel.topic, data, log_ns, publish_ns, sequence, channel))
                yield place, found

    def _read(self, file: BinaryIO, place: ChunkPlace) -> bytes:
        try:
            return read_chunk(file, place)
        except EpisodeError as error:
            raise EpisodeError(f"{self.path}: {error}; copy the file from where it was recorded again") from error


def open_episode(episode: str | Path, data: Path | None = None) -> EpisodeReader:
    """Open an episode named by path, id, unique beginning of an id, or ``latest``.

    Args:
        episode: Folder, MCAP file, id, beginning of an id, or ``latest``.
        data: Data folder to look ids up in; None takes ``$STATION_DATA``, else ``./data``.

    Raises:
        EpisodeError: not found, ambiguous, or not an episode of ours; one line that says what is there.
    """
    return EpisodeReader(signals_file(resolve(episode, data)))


def _log_ns(message: Message) -> int:
    return message.log_ns


def _join_stamps(messages: Iterable[Message]) -> Iterator[Message]:
    """Give each native message its stamp; the list of a flush follows the messages that it is of."""
    waiting: deque[Message] = deque()
    lines: dict[int, deque[bytes]] = {}
    for message in messages:
        if not message.channel.is_bookkeeping:
            waiting.append(message)
            continue
        for line in message.data.split(b"\n"):
            number, _, stamp = line.partition(b" ")
            if not number.isdigit():
                raise EpisodeError(f"a list of stamps holds {line[:40]!r}, expected a channel's number and a stamp")
            lines.setdefault(int(number[:_DIGITS]), deque()).append(stamp)
        while waiting and (not waiting[0].channel.is_native or lines.get(waiting[0].channel.id)):
            first = waiting.popleft()
            yield first._replace(stamp=lines[first.channel.id].popleft()) if first.channel.is_native else first
    yield from waiting


def _anchor(contents: Contents) -> Anchor | None:
    found = contents.metadata.get(layout.ANCHOR_RECORD)
    try:
        return msgspec.convert(found, Anchor, strict=False) if found else None
    except msgspec.ValidationError:
        return None


def _torn(contents: Contents) -> str | None:
    """Say in a line what of the file is missing."""
    if contents.cut_at is not None:
        return (
            f"cut off at byte {contents.cut_at} of {contents.size}: the record there is not whole; "
            f"the {len(contents.chunks)} chunks before it are"
        )
    if not contents.is_finished:
        return f"not finished: no index at its end; all of its {len(contents.chunks)} chunks are whole"
    return None
