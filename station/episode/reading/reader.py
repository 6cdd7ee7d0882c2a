"""Reading an episode: its streams, its messages in order, its vectors as arrays; also of a torn or unfinished file."""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterable, Iterator
from functools import cached_property, reduce
from pathlib import Path
from typing import Literal

from station.bus import codec
from station.bus.contracts import Contracts
from station.contract import Contract
from station.episode.reading.messages import Channel, Message, StreamInfo, Vectors
from station.episode.reading.part import Part
from station.episode.reading.vectors import numbers
from station.episode.storage import layout
from station.episode.storage.drops import Drops, drops_of
from station.episode.storage.folder import resolve, signals_file
from station.episode.storage.manifest import Manifest
from station.episode.storage.manifest_copy import choose_manifest
from station.errors import EpisodeError

__all__ = ["Channel", "EpisodeReader", "Message", "Order", "StreamInfo", "Vectors", "open_episode"]

log = logging.getLogger(__name__)

Order = Literal["file", "log"]


class EpisodeReader:
    """An episode on disk. Opens, reads and closes its files within each call; holds nothing open in between.

    Attributes:
        folder: Folder of the episode.
        path: The MCAP file: ``signals.mcap``, or ``signals.mcap.active`` when it was never finished.
        parts: That file, and those of pictures and clouds beside it where there are any.
        manifest: From ``manifest.yaml``, else from the attachment in the MCAP file.
        anchor: Clock of the log times, or None when the file does not say.
        is_active: Whether a file was never finished.
        torn: One line that says what was cut off, or None for whole files.
        skipped: After `vectors`: number of values per topic that did not fit their contract.
    """

    def __init__(self, path: Path) -> None:
        """Open by the path of the MCAP file.

        Raises:
            EpisodeError: cannot be read, or is no recording of ours.
        """
        self.path = path
        self.folder = path.parent
        signals = Part(path)
        beside, trouble = _beside(signals)
        self.parts = [signals, *beside]
        self._contents = signals.contents
        self.is_active = any(part.is_active for part in self.parts)
        self.anchor = signals.anchor
        self.manifest = self._read_manifest()
        told = [part.torn for part in self.parts if part.torn is not None]
        self.torn = "; ".join([*told, *trouble.values(), *self._missing(trouble)]) or None
        self.skipped: dict[str, int] = {}
        self._streams: list[StreamInfo] | None = None

    @property
    def episode_id(self) -> str:
        """The episode's id."""
        return self.manifest.episode_id or self._contents.metadata.get(layout.EPISODE_RECORD, {}).get("episode_id", "")

    @property
    def start_ns(self) -> int:
        """The instant that times are told from: the anchor, else the first message [ns since the epoch]."""
        if self.anchor is not None:
            return self.anchor.wall_ns
        return min((stream.first_ns for stream in self.streams() if stream.count), default=0)

    def streams(self) -> list[StreamInfo]:
        """Return every channel with its message count, by topic; the recorder's own bookkeeping is left out."""
        if self._streams is None:
            found: dict[int, tuple[Channel, int, int, int]] = {}
            for message in self.messages(raw=True):
                channel = message.channel
                _, count, first_ns, last_ns = found.get(channel.id) or (channel, 0, message.log_ns, message.log_ns)
                times = min(first_ns, message.log_ns), max(last_ns, message.log_ns)
                found[channel.id] = (channel, count + 1, *times)
            self._streams = sorted(
                (StreamInfo(channel=c, count=n, first_ns=first, last_ns=last) for c, n, first, last in found.values()),
                key=lambda stream: (stream.channel.topic, stream.channel.id),
            )
        return self._streams

    def channels(self) -> list[Channel]:
        """Return every channel that has messages, by topic; the messages of finished files are not read for it."""
        parts = [part.channels() for part in self.parts]
        if None in parts:
            return [stream.channel for stream in self.streams()]
        found = (channel for part in parts if part is not None for channel in part)
        return sorted(found, key=lambda channel: (channel.topic, channel.id))

    def topics(self) -> list[str]:
        """Return every key that has messages, sorted."""
        return sorted({channel.topic for channel in self.channels()})

    @cached_property
    def known(self) -> Contracts:
        """What is known of its robots and keys: what its servers stated, else what is registered."""
        return Contracts(self.manifest.servers.values())

    @cached_property
    def recorded(self) -> dict[str, Contract | None]:
        """The contract of every key that has values, as it was recorded; None where it was recorded without one."""
        found: dict[str, Contract | None] = {}
        for channel in self.channels():
            if not channel.is_deletion:
                found[channel.topic] = found.get(channel.topic) or channel.contract
        return found

    def contract(self, key: str) -> Contract | None:
        """Return the contract of a key as it was recorded, else as it is known: it may have been described only since.

        None for a key that nothing describes.
        """
        return self.recorded.get(key) or self.known.get(key)

    def messages(
        self, topics: Collection[str] | None = None, *, order: Order = "file", stamps: bool = False, raw: bool = False
    ) -> Iterator[Message]:
        """Iterate over messages, all or those of some topics.

        Args:
            topics: Keys; None for all.
            order: ``file`` is the order of arrival at the recorder; ``log`` sorts by log time, stable. A chunk of each
                file is in memory, with ``log`` those that overlap in time; with both stamps and ``log``, everything.
            stamps: Whether to join the exact stamp to each native message.
            raw: Whether pictures are left as they stand in the file, for whoever only counts messages: those of a
                compacted episode are decoded otherwise, 1 to 3 ms each.

        Raises:
            EpisodeError: a chunk in the middle of a file is damaged.
        """
        wanted = None if topics is None else frozenset(topics)
        parts = [part for part in self.parts if part.may_hold(wanted)]
        if order == "log":
            found = [part.in_log_order(wanted, stamps=stamps, raw=raw) for part in parts]
        else:
            found = [part.in_file_order(wanted, stamps=stamps, raw=raw) for part in parts]
        return reduce(_merged, found) if found else iter(())

    def messages_from(self, topics: Collection[str], from_ns: int) -> Iterator[Message]:
        """Iterate over messages of some topics in file order from a log time [ns] on, and some from shortly before it.

        What lies before is not read. Only of an episode whose files are finished.

        Raises:
            EpisodeError: a chunk in the middle of a file is damaged.
        """
        wanted = frozenset(topics)
        found = [part.from_instant(wanted, from_ns) for part in self.parts if part.may_hold(wanted)]
        return reduce(_merged, found) if found else iter(())

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

    @property
    def files(self) -> list[Path]:
        """The files that hold its messages."""
        return [part.path for part in self.parts]

    def _missing(self, trouble: Collection[layout.Names]) -> list[str]:
        """Return in a line each file that is not there though the manifest lists streams in it."""
        if self.path.name not in (layout.SIGNALS, layout.ACTIVE):
            return []
        found = []
        for names in layout.BULK_NAMES:
            is_there = names in trouble or any(part.path.name in names for part in self.parts)
            count = sum(stream.count for stream in self.manifest.streams if stream.file == names.final)
            if count and not is_there:
                what = "clouds" if names is layout.CLOUDS_NAMES else "pictures"
                found.append(f"{names.final} is not there, with {count} {what} that the manifest lists; bring it back")
        return found

    def _read_manifest(self) -> Manifest:
        manifest, problem = choose_manifest(self.folder, self.path, self._contents.attachments)
        if problem:
            log.warning("%s", problem)
        return manifest


def open_episode(episode: str | Path, data: Path | None = None) -> EpisodeReader:
    """Open an episode named by path, id, unique beginning of an id, or ``latest``.

    Args:
        episode: Folder, MCAP file, id, ``task/id``, beginning of an id, or ``latest``.
        data: Data folder to look ids up in; None takes ``$STATION_DATA``, else ``./data``.

    Raises:
        EpisodeError: not found, ambiguous, or not an episode of ours; one line that says what is there.
    """
    return EpisodeReader(signals_file(resolve(episode, data)))


def _beside(signals: Part) -> tuple[list[Part], dict[layout.Names, str]]:
    """Return the files of pictures and clouds of the episode whose signals these are; and what is wrong, in a line."""
    found: list[Part] = []
    trouble: dict[layout.Names, str] = {}
    has_any = signals.path.name in (layout.SIGNALS, layout.ACTIVE)
    for number, names in enumerate(layout.BULK_NAMES if has_any else (), 1):
        paths = (signals.path.with_name(name) for name in (names.final, names.active))
        if (path := next((path for path in paths if path.is_file()), None)) is None:
            continue
        try:
            part = Part(path, number)
        except EpisodeError as error:  # the signals can be read all the same
            trouble[names] = str(error)
            continue
        if part.anchor is not None and signals.anchor is not None and part.anchor != signals.anchor:
            trouble[names] = f"{path.name} is of another recording; put its own in its place, or take it away"
        else:
            found.append(part)
    return found, trouble


def _merged(signals: Iterable[Message], others: Iterator[Message]) -> Iterator[Message]:
    """Merge the messages of two files by log time, signals first: see `station.episode.writing.files`."""
    other = next(others, None)
    for message in signals:
        while other is not None and other.log_ns < message.log_ns:
            yield other
            other = next(others, None)
        yield message
    if other is not None:
        yield other
        yield from others
