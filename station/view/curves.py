"""Numbers of an episode or a live bus as named curves; the names are those of the contracts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from station.contract import Contract, Element
from station.protocols import Floats

CURVES = "curves"
_QUANTITIES = {
    "m": "position",
    "m/s": "velocity",
    "rad": "angle",
    "rad/s": "angular_velocity",
    "N m/rad": "stiffness",
    "N m s/rad": "damping",
    "ns": "time",
    "": "number",
}


def groups(elements: Sequence[Element]) -> dict[str, list[int]]:
    """Return the indices of elements by quantity (their unit in a word), so that each plot has one unit."""
    found: dict[str, list[int]] = {}
    for index, element in enumerate(elements):
        quantity = _QUANTITIES.get(element.unit, element.unit.replace("/", "_per_").replace(" ", "_"))
        found.setdefault(quantity, []).append(index)
    return found


def entity(contract: Contract, quantity: str) -> str:
    """Return the entity of the curves of one quantity of a key."""
    return f"{CURVES}/{contract.role}/{contract.key}/{quantity}"


def log_names(recording: rr.RecordingStream, contract: Contract) -> None:
    """Give the curves of a key the names of its elements, units included."""
    for quantity, indices in groups(contract.elements).items():
        names = [contract.elements[index].title for index in indices]
        recording.log(entity(contract, quantity), rr.SeriesLines(names=names), static=True)


def send_curves(
    recording: rr.RecordingStream, contract: Contract, index: Sequence[Any], values: NDArray[Any]
) -> list[str]:
    """Send all values of a key, shape (n, m), at n instants; return the entities that hold them."""
    log_names(recording, contract)
    entities = []
    for quantity, indices in groups(contract.elements).items():
        flat = np.ascontiguousarray(values[:, indices], dtype=np.float64).ravel()
        columns = rr.Scalars.columns(scalars=flat).partition(np.full(len(values), len(indices)))
        entities.append(entity(contract, quantity))
        recording.send_columns(entities[-1], index, columns)
    return entities


def log_values(recording: rr.RecordingStream, contract: Contract, values: Floats) -> None:
    """Log the newest values of a key, shape (m,)."""
    for quantity, indices in groups(contract.elements).items():
        recording.log(entity(contract, quantity), rr.Scalars(values[indices]))


def drawable(contracts: Iterable[Contract | None]) -> list[Contract]:
    """Return those contracts whose elements are named numbers worth a curve: all but clock readings."""
    return [item for item in contracts if item is not None and item.elements and item.elements[-1].unit != "ns"]
