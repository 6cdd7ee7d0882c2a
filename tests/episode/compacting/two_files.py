"""Episodes with their pictures in a file of their own, made of ones whose every byte and stamp was chosen."""

from __future__ import annotations

from pathlib import Path

from station.bus.tap import Write
from station.episode.reading.reader import open_episode
from tests.episode.filming import film


def in_two_files(source: Path, data: Path, *, flush_every: int = 50) -> Path:
    """Record what an episode holds once more, by the real writer; return the folder of the new one."""
    reader = open_episode(source)
    folder = data / source.parent.name / source.name
    anchor = reader.anchor
    assert anchor is not None
    writes = [
        Write(message.topic, message.data, message.stamp, anchor.mono_ns + message.log_ns - anchor.wall_ns)
        for message in reader.messages(stamps=True)
    ]
    batches = [writes[at : at + flush_every] for at in range(0, len(writes), flush_every)]
    film(folder, batches, anchor, servers=reader.manifest.servers)
    return folder
