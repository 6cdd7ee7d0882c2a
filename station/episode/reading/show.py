"""What one episode holds: its manifest, and its streams counted from the file."""

from __future__ import annotations

import msgspec

from station.episode.reading.reader import EpisodeReader
from station.episode.storage.channels import Channel
from station.episode.storage.drops import streams_of
from station.episode.storage.manifest import Manifest, Stream


class EpisodeFacts(msgspec.Struct, frozen=True, kw_only=True):
    """One episode.

    Attributes:
        path: Folder.
        files: Its files of messages, and the size of each [bytes].
        torn: What of them is missing, None for whole files.
        messages: Messages in them.
        first_s, last_s: First and last message, from the start of the episode [s]; None without messages.
        streams: Counted from the files, by key.
        manifest: The manifest; its own counts are from the end of the recording.
    """

    path: str
    files: dict[str, int]
    torn: str | None
    messages: int
    first_s: float | None
    last_s: float | None
    streams: list[Stream]
    manifest: Manifest


def show(reader: EpisodeReader) -> EpisodeFacts:
    """Count an episode.

    Raises:
        EpisodeError: a chunk in the middle of the file is damaged.
    """
    streams = count_streams(reader)
    return EpisodeFacts(
        path=str(reader.folder),
        files={path.name: path.stat().st_size for path in reader.files},
        torn=reader.torn,
        messages=sum(stream.count for stream in streams),
        first_s=min((stream.first_s for stream in streams if stream.first_s is not None), default=None),
        last_s=max((stream.last_s for stream in streams if stream.last_s is not None), default=None),
        streams=streams,
        manifest=reader.manifest,
    )


def count_streams(reader: EpisodeReader) -> list[Stream]:
    """Return what the manifest says of each stream, but from the file; by key, then by writer."""
    counted: dict[int, Channel] = {}
    start_ns: int | None = reader.anchor.wall_ns if reader.anchor else None
    for message in reader.messages(raw=True):
        found = message.channel
        channel = counted.get(found.id)
        if channel is None:
            channel = counted[found.id] = Channel(
                found.id, found.topic, found.source, found.encoding, found.file, found.contract
            )
        channel.count_message(message.sequence, message.log_ns)
        start_ns = message.log_ns if start_ns is None else start_ns
    streams = streams_of(counted.values(), reader.drops(), start_ns or 0, reader.contract)
    return sorted(streams, key=lambda stream: (stream.key, stream.writer, stream.source))
