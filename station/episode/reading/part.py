"""One MCAP file of an episode: its messages chunk by chunk, also of a torn or unfinished file."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import mcap.records
import msgspec

from station.episode.reading.messages import Channel, Message, channel_of
from station.episode.storage import layout
from station.episode.storage.anchor import Anchor
from station.episode.storage.bulk import value_in
from station.episode.storage.pictures import VIDEO_FORMAT, video_in
from station.episode.storage.records import ChunkPlace, Contents, parse_chunk, read_chunk, walk
from station.errors import EpisodeError
from station.video import VideoDecoder

_DIGITS = 20  # of a channel's number, which has 16 bits
_CHANNELS = 1 << 16


class Part:
    """A file. Opens, reads and closes it within each call.

    Args:
        path: The file.
        number: Of this file among those of its episode: the numbers of its channels begin at so many times 65536, so
            that no two channels of an episode share one.

    Attributes:
        path: As above.
        contents: What a walk over it found.
        anchor: Clock of its log times, or None when it does not say.
        is_active: Whether it was never finished.
        torn: One line that says what was cut off, or None for a whole file.

    Raises:
        EpisodeError: cannot be read, or is no recording of ours.
    """

    def __init__(self, path: Path, number: int = 0) -> None:
        self.path = path
        self._first_id = number * _CHANNELS
        self._name = next((names.final for names in layout.BULK_NAMES if path.name in names), layout.SIGNALS)
        self.contents = walk(path)
        if self.contents.profile != layout.PROFILE:
            raise EpisodeError(
                f"{path}: an MCAP file, but not a recording of this station "
                f"(profile {self.contents.profile!r}, expected {layout.PROFILE!r})"
            )
        self.anchor = _anchor(self.contents)
        self.is_active = path.name in {names.active for names in layout.ALL_NAMES} or not self.contents.is_finished
        torn = _torn(self.contents)
        self.torn = torn if torn is None or number == 0 else f"{path.name}: {torn}"

    def may_hold(self, topics: frozenset[str] | None) -> bool:
        """Whether there can be messages of some topics in it; only the chunks of an unfinished file would tell."""
        known = self.contents.channels if self.contents.is_finished else {}
        return topics is None or not known or any(record.topic in topics for record in known.values())

    def channels(self) -> list[Channel] | None:
        """Return the channels that have messages, by the summary of a finished file; None where only those tell."""
        known, counts = self.contents.channels, self.contents.counts
        if not self.contents.is_finished or not counts or not counts.keys() <= known.keys():
            return None
        found = [self._channel(known[number]) for number, count in counts.items() if count]
        return [channel for channel in found if not channel.is_bookkeeping]

    def in_file_order(
        self, topics: frozenset[str] | None, *, stamps: bool = False, raw: bool = False
    ) -> Iterator[Message]:
        """Iterate over the messages of some topics (None: all), joined to their exact stamps where those are wanted.

        Raw pictures and clouds are the typed messages around them, as they stand in the file.
        """
        if not stamps:
            return self._messages(self.contents.chunks, topics, raw=raw)
        found = self._messages(self.contents.chunks, None, raw=raw, pictures_of=topics, bookkeeping=True)
        found = _join_stamps(found, self._first_id)
        return (message for message in found if topics is None or message.topic in topics)

    def from_instant(self, topics: frozenset[str] | None, from_ns: int) -> Iterator[Message]:
        """Iterate over the messages of some topics from the first chunk on that reaches to a log time [ns].

        Only of a finished file: its summary says what the channels are that earlier chunks describe.
        """
        return self._messages((place for place in self.contents.chunks if place.end_ns >= from_ns), topics)

    def in_log_order(
        self, topics: frozenset[str] | None, *, stamps: bool = False, raw: bool = False
    ) -> Iterator[Message]:
        """Iterate over the messages of some topics by log time; with stamps all of them are in memory."""
        if stamps:
            return iter(sorted(self.in_file_order(topics, stamps=True, raw=raw), key=_log_ns))
        return self._merged_chunks(topics, raw=raw)

    def _messages(self, places: Iterable[ChunkPlace], topics: frozenset[str] | None, **how: Any) -> Iterator[Message]:
        for _, messages in self._chunks(places, topics, **how):
            yield from messages

    def _merged_chunks(self, topics: frozenset[str] | None, *, raw: bool) -> Iterator[Message]:
        """Merge chunks that overlap in time; holds no more than those in memory."""
        waiting: list[Message] = []
        places = sorted(self.contents.chunks, key=lambda place: place.start_ns)
        for place, messages in self._chunks(places, topics, raw=raw):
            ready = next((i for i, message in enumerate(waiting) if message.log_ns >= place.start_ns), len(waiting))
            yield from waiting[:ready]
            waiting = sorted([*waiting[ready:], *messages], key=_log_ns)
        yield from waiting

    def _chunks(
        self, places: Iterable[ChunkPlace], topics: frozenset[str] | None, *, bookkeeping: bool = False,
        raw: bool = False, pictures_of: frozenset[str] | None = None,
    ) -> Iterator[tuple[ChunkPlace, list[Message]]]:  # fmt: skip
        """Read chunk by chunk; yields each one's messages of the wanted topics.

        Pictures stay in their typed messages where they are wanted raw, or not `pictures_of` their topic are wanted.
        """
        records = dict(self.contents.channels)
        wanted: dict[int, Channel | None] = {}

        def choose(number: int) -> Channel | None:
            record = records.get(number)
            if record is None:
                raise EpisodeError(f"{self.path}: a message of channel {number}, which nothing describes")
            channel = self._channel(record)
            is_chosen = bookkeeping if channel.is_bookkeeping else (topics is None or record.topic in topics)
            wanted[number] = channel if is_chosen else None
            return wanted[number]

        with self._opened() as file:
            for place in places:
                found: list[Message] = []
                videos: dict[int, VideoDecoder] = {}  # each chunk of a video begins with key frames
                for number, sequence, log_ns, publish_ns, data in parse_chunk(self._read(file, place), records):
                    channel = wanted[number] if number in wanted else choose(number)
                    if channel is None:
                        continue
                    is_opened = channel.is_typed and not raw and (pictures_of is None or channel.topic in pictures_of)
                    value = self._value(data, channel, videos) if is_opened else data
                    found.append(Message(channel.topic, value, log_ns, publish_ns, sequence, channel))
                yield place, found

    def _opened(self) -> BinaryIO:
        try:
            return self.path.open("rb")
        except OSError as error:  # a recording that ends renames it
            raise EpisodeError(f"{self.path}: cannot be read: {error.strerror}; open the episode anew") from error

    def _channel(self, record: mcap.records.Channel) -> Channel:
        return channel_of(record, file=self._name, first_id=self._first_id)

    def _value(self, data: bytes, channel: Channel, videos: dict[int, VideoDecoder]) -> bytes:
        try:
            if not channel.video:
                return value_in(data, self._name)
            if channel.video != VIDEO_FORMAT:
                raise ValueError(f"video of format {channel.video!r}, this station reads {VIDEO_FORMAT}; upgrade it")
            if channel.id not in videos:
                videos[channel.id] = VideoDecoder()
            return videos[channel.id].jpeg(*video_in(data))
        except ValueError as error:
            what = "cloud" if self._name == layout.CLOUDS else "picture"
            raise EpisodeError(f"{self.path}: a message of {channel.topic!r} holds no {what}: {error}") from error

    def _read(self, file: BinaryIO, place: ChunkPlace) -> bytes:
        try:
            return read_chunk(file, place)
        except EpisodeError as error:
            raise EpisodeError(
                f"{self.path}: {error}; copy the file from where it was recorded again, or keep all but what is "
                f"damaged: station episodes repair {self.path.parent}"
            ) from error


def _log_ns(message: Message) -> int:
    return message.log_ns


def _join_stamps(messages: Iterable[Message], first_id: int) -> Iterator[Message]:
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
            lines.setdefault(first_id + int(number[:_DIGITS]), deque()).append(stamp)
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
    """Return in a line what of the file is missing."""
    if contents.cut_at is not None:
        return (
            f"cut off at byte {contents.cut_at} of {contents.size}: the record there is not whole; "
            f"the {len(contents.chunks)} chunks before it are"
        )
    if not contents.is_finished:
        return f"not finished: no index at its end; all of its {len(contents.chunks)} chunks are whole"
    return None
