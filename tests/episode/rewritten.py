"""A recorded episode written once more, with something changed on the way."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from station.bus import keys
from station.contract import Contract
from station.episode.reading.reader import open_episode
from tests.episode.synthetic import WALL_START_NS, EpisodeBuilder

Change = Callable[[str, bytes, float], tuple[bytes, float] | None]
"""Gets a key, its value, and when it was written from the start [s]; returns both as they shall be, or None to leave
the write out, its number too."""


def as_it_is(key: str, value: bytes, at_s: float) -> tuple[bytes, float] | None:
    """Change nothing."""
    return value, at_s


def rewritten(
    folder: Path, data: Path, change: Change = as_it_is, *, contracts: dict[str, Contract] | None = None
) -> Path:
    """Write an episode of ours again, into another data folder, and return its folder.

    Args:
        folder: The episode.
        data: Where the new one goes.
        change: What becomes of each write.
        contracts: In the place of the recorded ones, by key.
    """
    reader = open_episode(folder)
    builder = EpisodeBuilder(data)
    builder.contracts |= {key: item for key, item in reader.recorded.items() if item is not None}
    builder.contracts |= contracts or {}
    for message in reader.messages():
        if message.channel.is_bookkeeping or keys.is_stamp(message.topic):
            continue
        at_s = (message.publish_ns - WALL_START_NS) * 1e-9
        if (changed := change(message.topic, message.data, at_s)) is not None:
            value, written_s = changed
            lag_s = (message.log_ns - WALL_START_NS) * 1e-9 - written_s
            builder.write({message.topic: value}, at_s=written_s, writer=message.channel.writer, lag_s=lag_s)
    return builder.finish({"servers": reader.manifest.servers})
