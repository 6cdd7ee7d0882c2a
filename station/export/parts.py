"""What a robot moves beside its body: hands and neck, each with a command and a state of its own."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from station.episode.reading.reader import EpisodeReader
from station.export import tracks
from station.export.columns import key_columns
from station.protocols import Floats

_STILL = 0.01  # in the unit of the key, rad for hands and neck: a sensor's noise is less


class Part(NamedTuple):
    """A hand, or the neck: the keys of its command and of its state, None for one that is not in the episode."""

    name: str
    action: str | None
    state: str | None


def moving_parts(reader: EpisodeReader, robot: str) -> list[Part]:
    """Return the parts of a robot whose command or state changed in an episode, in the order of its description.

    Only keys count whose contract names their numbers.

    Raises:
        EpisodeError: the file is damaged.
    """

    def if_named(key: str) -> str | None:
        contract = reader.contract(key) if key in reader.recorded else None
        return key if contract is not None and contract.vector_codec and contract.elements else None

    description = reader.known.robot(robot)
    parts = description.part_keys() if description is not None else {}
    found = [Part(name, if_named(action), if_named(state)) for name, (action, state) in parts.items()]
    wanted = [key_columns(reader, key) for part in found for key in (part.action, part.state) if key is not None]
    read = tracks.read(reader, wanted, ()).tracks if wanted else {}
    moved = {key for key, track in read.items() if _moves(track.values)}
    return [part for part in found if moved & {part.action, part.state}]


def _moves(values: Floats) -> bool:
    return len(values) > 1 and bool(np.ptp(values, axis=0).max() > _STILL)
