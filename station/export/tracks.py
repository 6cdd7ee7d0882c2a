"""What an export reads of an episode, in one pass: numbers of keys and times of pictures, on one clock.

The clock is the episode's. A write falls on it by its writer's own time where writer and recorder share a monotonic
clock, else by its arrival at the recorder: another machine's wall clock may be wrong by more than a step.
"""

from __future__ import annotations

from array import array
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from station.bus import codec
from station.bus import stamp as stamps
from station.episode.reading import frames
from station.episode.reading.messages import Channel, Ints, Message
from station.episode.reading.reader import EpisodeReader
from station.export.columns import KeyColumns
from station.export.words import Spell
from station.protocols import Floats

_MOST_NAMES, _OTHERS = 1000, "others"  # words of a key in one episode; a client may invent them


@dataclass(frozen=True)
class Track:
    """One key.

    Attributes:
        times_ns: When each of k values was written, ascending [ns since the epoch].
        values: Shape (k, m).
        writers: Which of its writers wrote it, a small number, shape (k,).
        skipped: Values that did not fit the contract, or were not finite, and are not among the k.
    """

    times_ns: Ints
    values: Floats
    writers: Ints
    skipped: int


@dataclass(frozen=True)
class Words:
    """A key that speaks in words: when each of k was written, ascending [ns], and which one, an index of `names`."""

    times_ns: Ints
    codes: Ints
    names: tuple[str, ...]


@dataclass(frozen=True)
class Recorded:
    """What was read of an episode.

    Attributes:
        tracks: By key.
        pictures: For each camera's key, when its pictures were taken, in order of arrival [ns].
        words: By key; empty where the episode has not one.
    """

    tracks: dict[str, Track]
    pictures: dict[str, Ints]
    words: dict[str, Words] = field(default_factory=dict)


@dataclass
class _Collector:
    columns: KeyColumns
    times: array[int] = field(default_factory=lambda: array("q"))
    writers: array[int] = field(default_factory=lambda: array("q"))
    values: bytearray = field(default_factory=bytearray)
    skipped: int = 0

    def feed(self, message: Message, time_ns: int, writer: int) -> None:
        row = _numbers(message.data, self.columns)
        if row is None:
            self.skipped += 1
            return
        self.times.append(time_ns)
        self.writers.append(writer)
        self.values += row.tobytes()

    def track(self) -> Track:
        times, writers = np.array(self.times, dtype=np.int64), np.array(self.writers, dtype=np.int64)
        values = np.frombuffer(bytes(self.values)).reshape(len(times), len(self.columns.names))
        order = np.argsort(times, kind="stable")
        return Track(times[order], values[order], writers[order], self.skipped)


@dataclass
class _Listener:
    spell: Spell
    times: array[int] = field(default_factory=lambda: array("q"))
    codes: array[int] = field(default_factory=lambda: array("q"))
    names: dict[str, int] = field(default_factory=dict)

    def feed(self, message: Message, time_ns: int) -> None:
        name = self.spell(message)
        if name not in self.names and len(self.names) >= _MOST_NAMES:
            name = _OTHERS
        self.times.append(time_ns)
        self.codes.append(self.names.setdefault(name, len(self.names)))

    def words(self) -> Words:
        times, codes = np.array(self.times, dtype=np.int64), np.array(self.codes, dtype=np.int64)
        order = np.argsort(times, kind="stable")
        return Words(times[order], codes[order], tuple(self.names))


def read(
    reader: EpisodeReader,
    columns: Sequence[KeyColumns],
    cameras: Collection[str],
    spellings: Mapping[str, Spell] | None = None,
) -> Recorded:
    """Read the numbers of keys and the times of pictures of an episode; pictures themselves are not kept.

    Args:
        reader: The episode.
        columns: Keys; one without a fitting value has an empty track.
        cameras: Keys of cameras.
        spellings: Keys that speak in words, and how; as `station.export.words.spellings` gives them.

    Raises:
        EpisodeError: the file is damaged.
    """
    collectors = {one.key: _Collector(one) for one in columns}
    taken = {key: array("q") for key in cameras}
    listeners = {key: _Listener(spell) for key, spell in (spellings or {}).items()}
    boot = reader.anchor.boot if reader.anchor is not None else ""
    writers: dict[str, int] = {}
    for message in reader.messages({*collectors, *taken, *listeners}, stamps=bool(taken)):
        if message.channel.is_deletion:
            continue
        if message.topic in taken:
            taken[message.topic].append(frames.captured_ns(message))
        elif message.topic in listeners:
            listeners[message.topic].feed(message, written_ns(message, boot))
        else:
            writer = writers.setdefault(message.channel.source, len(writers))
            collectors[message.topic].feed(message, written_ns(message, boot), writer)
    tracks = {key: collector.track() for key, collector in collectors.items()}
    pictures = {key: np.array(times, dtype=np.int64) for key, times in taken.items()}
    return Recorded(tracks, pictures, {key: one.words() for key, one in listeners.items() if one.times})


def written_ns(message: Message, boot: str) -> int:
    """Return when a value was written, on the episode's clock, whose monotonic clock is that of a boot [ns]."""
    return message.publish_ns if shares_clock(message.channel, boot) else message.log_ns


def shares_clock(channel: Channel, boot: str) -> bool:
    """Whether times of writing are on the episode's clock: of the recorder's machine, or placed there by it."""
    return channel.is_placed or (bool(boot) and stamps.boot_of(channel.source) == boot)


def skipped(recorded: Recorded) -> Mapping[str, int]:
    """Return how many values of each key did not fit, where some did not."""
    return {key: track.skipped for key, track in recorded.tracks.items() if track.skipped}


def _numbers(data: bytes, columns: KeyColumns) -> Floats | None:
    try:
        row = codec.parse_vector(columns.codec, data)
    except codec.BadValue:
        return None
    return row if len(row) == len(columns.names) and np.isfinite(row).all() else None
