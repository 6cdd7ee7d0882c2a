"""Which streams an episode has: what each holds, how its numbers are called, how often it was written."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Literal

from station.episode.reading.messages import Channel
from station.episode.reading.reader import EpisodeReader
from station.episode.reading.show import count_streams
from station.episode.storage import layout, pictures
from station.episode.storage.bulk import CLOUD
from station.episode.storage.manifest import Stream as ListedStream

Holds = Literal["numbers", "json", "pictures", "clouds", "text", "bytes"]

_TOLD = ("control", "event")


@dataclass(frozen=True)
class Stream:
    """One key as one process wrote it.

    Attributes:
        key: Key on the bus.
        writer: Server that wrote it; ``foreign`` for a writer without stamps.
        role: ``command``, ``state``, ``policy``, ``sensor``, ``network``, ``event``, ``control`` or ``unknown``.
        holds: What its values are; ``bytes`` where the recording does not say.
        names: Names of its numbers, empty where the recording names none.
        units: Units of these numbers, "" for none.
        nominal_rate_hz: Rate at which it is meant to be written [Hz]; None for what is written as things happen.
        rate_hz: Mean rate of the recorded writes [Hz]; None for fewer than two.
        count: Recorded writes.
        lost: Writes that are missing, by the numbers that the writer gave them.
        note: Frame, order and traps, in a sentence.
    """

    key: str
    writer: str
    role: str
    holds: Holds
    names: tuple[str, ...]
    units: tuple[str, ...]
    nominal_rate_hz: float | None
    rate_hz: float | None
    count: int
    lost: int
    note: str


def read_streams(reader: EpisodeReader) -> list[Stream]:
    """Return the streams of an episode by key: counted by its recorder where that finished it, else from its files."""
    channels = {(channel.topic, channel.source): channel for channel in values_of(reader)}
    listed = [stream for stream in reader.manifest.streams if stream.encoding != layout.DELETED]
    is_whole = reader.torn is None and not reader.is_active
    if not is_whole or {(stream.key, stream.source) for stream in listed} != channels.keys():
        listed = [stream for stream in count_streams(reader) if stream.encoding != layout.DELETED]
    streams = (_stream(one, channels[one.key, one.source]) for one in listed)
    return sorted(streams, key=lambda stream: (stream.key, stream.writer))


def values_of(reader: EpisodeReader) -> list[Channel]:
    """Return the channels that hold values; others say only that a key was deleted."""
    return [channel for channel in reader.channels() if not channel.is_deletion]


def holds(channels: Collection[Channel]) -> Holds:
    """Return what the values of one key are, by all of its channels."""
    contract = next((channel.contract for channel in channels if channel.contract is not None), None)
    if contract is None:
        return "json" if all(channel.encoding == layout.JSON for channel in channels) else "bytes"
    if contract.codec in pictures.FORMATS:
        return "pictures"
    if contract.codec == CLOUD:
        return "clouds"
    if contract.vector_codec is not None or contract.codec in ("integer", "f64-rows"):
        return "numbers"
    return "json" if contract.codec == "json" else "text"


def _stream(one: ListedStream, channel: Channel) -> Stream:
    contract = channel.contract
    return Stream(
        key=one.key,
        writer=one.writer,
        role=one.role,
        holds=holds([channel]),
        names=contract.names if contract is not None else (),
        units=tuple(element.unit for element in contract.elements) if contract is not None else (),
        nominal_rate_hz=contract.rate_hz if contract is not None else None,
        rate_hz=one.rate_hz,
        count=one.count,
        lost=one.lost,
        note=contract.note if contract is not None else "",
    )


def lines(streams: Sequence[Stream]) -> list[str]:
    """Return a line of text per stream, in columns; what the station's processes tell each other is counted in one."""
    shown = [stream for stream in streams if stream.role not in _TOLD]
    width = max((len(stream.key) for stream in shown), default=0)
    rows = [
        f"  {one.key:<{width}}  {_what(one):<12} {'' if one.rate_hz is None else f'{one.rate_hz:.1f} Hz':>10}"
        f" {one.count:>8} × {one.writer}"
        for one in shown
    ]
    left_out = f"  and {len(streams) - len(shown)} more of the roles {' and '.join(_TOLD)}, in episode.streams"
    return [*rows, left_out] if len(shown) < len(streams) else rows


def _what(stream: Stream) -> str:
    return f"{len(stream.names)} {stream.holds}" if stream.names else stream.holds
