"""Enriching an episode: a file of typed siblings beside its signals, made from them and never instead of them."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from typing import BinaryIO, Literal, NamedTuple

import msgspec
from mcap.writer import Writer

from station.bus import codec
from station.contract import WORLD_FRAME, Contract
from station.enrich import source
from station.enrich.scalars import Shape
from station.enrich.siblings import TRANSFORM, Siblings, siblings
from station.enrich.still import optics_of
from station.enrich.vector import TypeNames
from station.episode.reading.frames import all_pictures
from station.episode.reading.messages import Channel
from station.episode.reading.reader import EpisodeReader
from station.episode.storage.left_open import is_left_open
from station.episode.storage.pictures import FORMATS
from station.episode.storage.whole_file import whole_file
from station.errors import EpisodeError
from station.protobuf import schema as protobuf

__all__ = ["Enriched", "Progress", "enrich"]

Progress = Callable[[int, int], None]
"""Called with messages done and messages in all, every few of them."""

_TELL_EVERY = 2000  # messages
_NO_CONTRACT = "nothing describes it: it has no contract"
_NO_PICTURES = "pictures were not wanted; they are in the recording"


class Enriched(msgspec.Struct, frozen=True, kw_only=True):
    """What became of one episode.

    Attributes:
        state: ``written``; or ``current``: it was there already, made of the same recording in the same manner.
        episode_id, path: The episode, and the enriched file.
        topics, messages: Typed topics, and messages on all of them.
        left_out: Why a key has no typed topic, by key.
        unfit: Values that do not fit their contract, by key; they are left out.
        size_bytes, seconds: Size of the file, and the time that it took [s].
    """

    state: Literal["written", "current"]
    episode_id: str
    path: str
    topics: int = 0
    messages: int = 0
    left_out: dict[str, str] = {}
    unfit: dict[str, int] = {}
    size_bytes: int = 0
    seconds: float = 0.0


def enrich(
    reader: EpisodeReader, *, is_forced: bool = False, pictures: bool = True, progress: Progress | None = None
) -> Enriched:  # fmt: skip
    """Write ``enriched.mcap`` beside the signals of an episode; log and publish times and sequence numbers are theirs.

    Interrupted at any moment, it leaves what was there. Needs no more memory than a chunk of the recording and the
    index of the new file.

    Args:
        reader: The episode.
        is_forced: Make it anew though it is current.
        pictures: Whether pictures get typed topics: then the file is as large as those are. Without, the file that
            holds them is not even read.
        progress: Told how far it is.

    Raises:
        EpisodeError: the episode is being recorded, was never finished, is damaged, or changed meanwhile; or the disk
            refused the file.
    """
    began, path = time.perf_counter(), reader.folder / source.ENRICHED
    _expect_finished(reader)
    try:
        before = source.identities(reader, pictures=pictures)
        facts = source.facts(reader.episode_id, source.origins(before), pictures=pictures)
        if not is_forced and source.is_current(path, facts):
            return Enriched(state="current", episode_id=reader.episode_id, path=str(path))
        survey = _survey(reader, _topics(reader, pictures=pictures))
        with whole_file(path) as file:
            made = _Output(file, facts, survey)
            made.add_optics(reader)
            made.fill(reader, survey, progress)
            made.finish()
            if source.identities(reader, pictures=pictures) != before:
                raise EpisodeError(
                    f"{reader.folder}: changed while it was read; enrich it again when it is written no more"
                )
        size_bytes = path.stat().st_size
    except OSError as error:
        why = error.strerror or str(error)
        raise EpisodeError(
            f"{path}: cannot be written: {why}; make room or the folder writable, run it again"
        ) from error
    return Enriched(
        state="written", episode_id=reader.episode_id, path=str(path), topics=len(made.topics), messages=made.messages,
        left_out={**made.left_out, **({} if pictures else dict.fromkeys(all_pictures(reader).values(), _NO_PICTURES))},
        unfit=dict(made.unfit), size_bytes=size_bytes, seconds=time.perf_counter() - began,
    )  # fmt: skip


def _expect_finished(reader: EpisodeReader) -> None:
    if reader.torn is None and not reader.is_active:
        return
    if reader.is_active and not is_left_open(reader.folder):
        raise EpisodeError(f"{reader.path}: is being recorded; enrich it when the recording is stopped")
    remedy = f"station episodes repair {reader.episode_id or reader.folder}"
    what = "was never finished" if reader.is_active else "is not whole"
    raise EpisodeError(f"{reader.path}: {what} ({reader.torn}); repair it first: {remedy}")


def _topics(reader: EpisodeReader, *, pictures: bool) -> set[str] | None:
    """Return the keys that are read; None for all."""
    return None if pictures else {*reader.topics()} - {*all_pictures(reader).values()}


class _Survey(NamedTuple):
    """Keys that are read (None: all), channels by number, messages in all, what the JSON objects of each key hold."""

    topics: set[str] | None
    channels: dict[int, Channel]
    messages: int
    shapes: dict[str, Shape]


def _survey(reader: EpisodeReader, topics: set[str] | None) -> _Survey:
    """Read the episode once: a schema must be written before the first message of it."""
    channels: dict[int, Channel] = {}
    shapes: dict[str, Shape] = {}
    count = 0
    for message in reader.messages(topics, raw=True):
        count += 1
        channel = message.channel
        if channel.id not in channels:
            channels[channel.id] = channel
            shapes.setdefault(channel.topic, Shape())
        if channel.contract is not None and channel.contract.codec == "json" and not channel.is_deletion:
            try:
                shapes[channel.topic].learn(codec.parse_json(message.data))
            except codec.BadValue:
                continue  # counted as unfit when the file is written
    return _Survey(topics, channels, count, shapes)


class _Output:
    """The enriched file while it is written."""

    def __init__(self, file: BinaryIO, facts: dict[str, str], survey: _Survey) -> None:
        self.messages = 0
        self.topics: set[str] = set()
        self.left_out: dict[str, str] = {}
        self.unfit: Counter[str] = Counter()
        self._writer = Writer(file)
        self._writer.start(profile="", library="teleop-station")
        self._writer.add_metadata(source.RECORD, facts)
        self._schemas: dict[protobuf.Schema, int] = {}
        self._made: dict[Contract, Siblings | str] = {}
        self._names = TypeNames()
        self._routes: dict[int, tuple[Siblings, list[int]]] = {}
        for channel in survey.channels.values():
            self._plan(channel, survey.shapes[channel.topic])

    def fill(self, reader: EpisodeReader, survey: _Survey, progress: Progress | None) -> None:
        """Write the siblings of every message, in the order of the recording."""
        has_pictures = any(_is_picture(channel) for channel in survey.channels.values())
        for done, message in enumerate(reader.messages(survey.topics, stamps=has_pictures)):
            if progress is not None and done % _TELL_EVERY == 0:
                progress(done, survey.messages)
            route = self._routes.get(message.channel.id)
            if route is None:
                continue
            encoded = route[0].encode(message)
            if encoded is None:
                self.unfit[message.topic] += 1
                continue
            for number, data in zip(route[1], encoded, strict=True):
                self._writer.add_message(number, message.log_ns, data, message.publish_ns, message.sequence)
                self.messages += 1
        if progress is not None:
            progress(survey.messages, survey.messages)

    def add_optics(self, reader: EpisodeReader) -> None:
        """Write once, at the start, what stands still: optics of cameras, and where they are mounted."""
        frames = {topic.removesuffix(f"/{TRANSFORM}") for topic in self.topics if topic.endswith(f"/{TRANSFORM}")}
        for key, found in optics_of(reader, frames | {WORLD_FRAME}).items():
            if isinstance(found, str):
                self.left_out[key] = found
                continue
            schema, data = found
            number = self._writer.register_channel(key, protobuf.ENCODING, self._schema(schema))
            self._writer.add_message(number, reader.start_ns, data, reader.start_ns)
            self.topics.add(key)
            self.messages += 1

    def finish(self) -> None:
        """Write the index."""
        self._writer.finish()

    def _plan(self, channel: Channel, shape: Shape) -> None:
        """Register the typed topics of a channel, or note why it has none; a deletion has no value."""
        if channel.is_deletion:
            return
        if channel.contract is None:
            self.left_out[channel.topic] = _NO_CONTRACT
            return
        contract = msgspec.structs.replace(channel.contract, key=channel.topic)
        if contract not in self._made:
            self._made[contract] = siblings(contract, shape, self._names.new(channel.topic))
        made = self._made[contract]
        if isinstance(made, str):
            self.left_out[channel.topic] = made
            return
        metadata = {
            "source": channel.source,
            "writer": channel.writer,
            "contract": msgspec.json.encode(contract).decode(),
        }
        numbers = [
            self._writer.register_channel(topic, protobuf.ENCODING, self._schema(schema), metadata)
            for topic, schema in made.topics
        ]
        self._routes[channel.id] = made, numbers
        self.topics |= {topic for topic, _ in made.topics}

    def _schema(self, schema: protobuf.Schema) -> int:
        if schema not in self._schemas:
            self._schemas[schema] = self._writer.register_schema(schema.name, protobuf.ENCODING, schema.data)
        return self._schemas[schema]


def _is_picture(channel: Channel) -> bool:
    return channel.contract is not None and channel.contract.codec in FORMATS
