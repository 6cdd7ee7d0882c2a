"""Which episodes are for training and which are set aside: by a seed and their ids, whatever else is exported."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

from station.export.kind import Shard

TRAIN, VAL = "train", "val"


def split(shards: Sequence[Shard], share: float, seed: int) -> dict[str, list[Shard]]:
    """Return the shards for training, then those set aside, each in the order given.

    LeRobot knows a part of a data set as a range of episodes, so those set aside come last. At least one is set aside
    when a share is asked for and there are two, and at least one is left.
    """
    count = min(max(1, round(share * len(shards))), len(shards) - 1) if share > 0.0 else 0
    ranked = sorted(shards, key=lambda shard: _rank(shard.source.episode_id, seed))
    aside = {shard.source.episode_id for shard in ranked[:count]}
    return {
        TRAIN: [shard for shard in shards if shard.source.episode_id not in aside],
        VAL: [shard for shard in shards if shard.source.episode_id in aside],
    }


def ranges(parts: dict[str, list[Shard]]) -> dict[str, str]:
    """Return the parts as ranges of episodes, ``"0:80"``; an empty part is left out."""
    found: dict[str, str] = {}
    begin = 0
    for name, shards in parts.items():
        if shards:
            found[name] = f"{begin}:{begin + len(shards)}"
        begin += len(shards)
    return found


def _rank(episode_id: str, seed: int) -> str:
    return hashlib.sha256(f"{seed}:{episode_id}".encode()).hexdigest()
