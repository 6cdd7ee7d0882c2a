"""Converts an episode with one of the quick looks."""

from __future__ import annotations

from pathlib import Path

from adapters.exports.named_rows import QuickLookOptions
from station import registry
from station.export.kind import ShardResult, Source


def converted(name: str, episode: Path, out: Path, *keys: str) -> ShardResult:
    """Make the shard of an episode in a format of that name."""
    kind, source = registry.find("export", name), Source(episode_id=episode.name, folder=str(episode))
    out.mkdir()
    made: ShardResult = kind.convert(source, kind.prepare([source], QuickLookOptions(keys=keys)), out)
    return made
