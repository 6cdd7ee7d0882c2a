"""What a robot moves beside its body: hands and neck, each with a command and a state of its own."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from station.bus import keys
from station.episode.reading.reader import EpisodeReader
from station.export import tracks
from station.export.columns import contract_of, key_columns, recorded_contracts
from station.protocols import Floats

_STILL = 0.01  # in the unit of the key, rad for hands and neck: a sensor's noise is less


class Part(NamedTuple):
    """A hand, or the neck: the keys of its command and of its state, None for one that is not in the episode."""

    name: str
    action: str | None
    state: str | None


def parts(robot: str) -> dict[str, tuple[str, str]]:
    """Return the keys of command and state of whatever a robot may have beside its body, by name, in a fixed order."""
    return {
        "left hand": (keys.action_hand("left", robot), keys.state_hand("left", robot)),
        "right hand": (keys.action_hand("right", robot), keys.state_hand("right", robot)),
        "neck": (keys.action_neck(robot), keys.state_neck(robot)),
        "hands": (keys.action_hands(robot), keys.state_hands(robot)),
    }


def moving_parts(reader: EpisodeReader, robot: str) -> list[Part]:
    """Return the parts of a robot whose command or state changed in an episode, in the order of `parts`.

    Only keys count whose contract names their numbers.

    Raises:
        EpisodeError: the file is damaged.
    """
    recorded = recorded_contracts(reader)

    def if_named(key: str) -> str | None:
        contract = contract_of(recorded, key) if key in recorded else None
        return key if contract is not None and contract.vector_codec and contract.elements else None

    found = [Part(name, if_named(action), if_named(state)) for name, (action, state) in parts(robot).items()]
    wanted = [key_columns(reader, key) for part in found for key in (part.action, part.state) if key is not None]
    read = tracks.read(reader, wanted, ()).tracks if wanted else {}
    moved = {key for key, track in read.items() if _moves(track.values)}
    return [part for part in found if moved & {part.action, part.state}]


def _moves(values: Floats) -> bool:
    return len(values) > 1 and bool(np.ptp(values, axis=0).max() > _STILL)
