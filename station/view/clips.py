"""Which clip of a motion is playing: a tour says in its facts where each of its clips begins."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any, NamedTuple

from station.bus import codec


class Clip(NamedTuple):
    """A named part of a motion, in motion time [s]."""

    name: str
    start_s: float
    end_s: float


def clips(facts: Mapping[str, Any]) -> list[Clip]:
    """Return the parts of a motion, in order; none where its facts tell of none.

    Args:
        facts: What a manifest says of the motion. Parts stand under ``clips``, each with ``name``, ``start_s`` and,
            unless the next one begins where it ends, ``end_s``.
    """
    listed = facts.get("clips")
    if not isinstance(listed, Sequence) or isinstance(listed, str):
        return []
    named = [
        (str(part["name"]), start_s, codec.number(part.get("end_s")))
        for part in listed
        if isinstance(part, Mapping) and "name" in part and (start_s := codec.number(part.get("start_s"))) is not None
    ]
    duration_s = codec.number(facts.get("duration_s"))
    ends = [*(start_s for _, start_s, _ in named), math.inf if duration_s is None else duration_s][1:]
    return [
        Clip(name, start_s, end_s if own_s is None else own_s)
        for (name, start_s, own_s), end_s in zip(named, ends, strict=False)
    ]


def name_at(parts: Sequence[Clip], time_s: float) -> str:
    """Return the name of the clip that plays at a motion time [s]; "" between clips and where there are none."""
    return next((part.name for part in parts if part.start_s <= time_s < part.end_s), "")


def short_name(reference: str) -> str:
    """Return what a person calls a motion: ``walk_001`` for ``twist2:motions/walk_001.pkl``, ``wave#mirror`` for
    ``builtin:wave#mirror``."""
    plain, mark, changes = reference.rpartition(":")[2].partition("#")
    return PurePath(plain).stem + mark + changes
